"""Texture space: the points of the head that texels show, and noise, steps and bumps to paint with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.ndimage import distance_transform_edt, map_coordinates

from preprocess.synthetic.rendering.mesh import rasterize


@dataclass(frozen=True)
class Texels:
    """Texels that show the surface.

    Attributes:
        size: Width and height of the texture.
        rows: Row of each texel (v upward).
        columns: Column of each texel.
        face: Face under each texel.
        points: Position of each texel on the generic head, m.
    """

    size: int
    rows: Int[ndarray, " N"]
    columns: Int[ndarray, " N"]
    face: Int[ndarray, " N"]
    points: Float[ndarray, "N 3"]

    def image(self, values: Float[ndarray, "N *C"]) -> Float[ndarray, "R R *C"]:  # noqa: F821 - names of axes
        """Values of the texels as a texture; other texels take the nearest value."""
        canvas = np.zeros((self.size, self.size, *values.shape[1:]), np.float32)
        canvas[self.rows, self.columns] = values
        empty = np.ones((self.size, self.size), bool)
        empty[self.rows, self.columns] = False
        nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
        return canvas[nearest[0], nearest[1]]


def locate_texels(
    points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], uv: Float[ndarray, "F 3 2"], size: int
) -> Texels:
    """Texels that the triangles of a mesh cover in a texture of `size` × `size`."""
    flat = np.concatenate((uv.reshape(-1, 2) * size, np.ones((3 * len(uv), 1))), axis=1)
    seen = rasterize(flat.astype(np.float32), np.arange(3 * len(uv)).reshape(-1, 3), size, size)
    rows, columns = np.nonzero(seen.face >= 0)
    face = seen.face[rows, columns]
    second, third = seen.weights[rows, columns].T[..., None]
    corners = points[faces[face]]
    at = corners[:, 0] * (1 - second - third) + corners[:, 1] * second + corners[:, 2] * third
    return Texels(size, rows, columns, face, at)


def noise(points: Float[ndarray, "N 3"], scale: float, seed: int) -> Float[ndarray, " N"]:
    """Smooth noise in about [−1, 1] with features of size `scale`, m."""
    lattice = np.random.default_rng(seed).uniform(-1, 1, (24, 24, 24)).astype(np.float32)
    at = points.T / scale
    cell = np.floor(at)
    share = at - cell
    return 1.6 * map_coordinates(lattice, cell + share * share * (3 - 2 * share), order=1, mode="grid-wrap")


def smoothstep(low: float, high: float, values: Float[ndarray, " N"]) -> Float[ndarray, " N"]:
    """A smooth step from 0 at `low` to 1 at `high`; descending if `low` is larger."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return share * share * (3 - 2 * share)


def mirrored_gaussian(
    points: Float[ndarray, "N 3"], center: tuple[float, float, float], reach: tuple[float, float, float]
) -> Float[ndarray, " N"]:
    """A Gaussian around a point and its mirror image in x, 1 at the center."""
    folded = np.column_stack((np.abs(points[:, 0]), points[:, 1:]))
    return np.exp(-(((folded - center) / reach) ** 2).sum(axis=1))


def to_linear(srgb: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Linear colors of sRGB colors (IEC 61966-2-1), clipped to [0, 1]."""
    srgb = np.clip(srgb, 0.0, 1.0)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_srgb(linear: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Linear colors as sRGB, clipped to [0, 1]."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055).astype(np.float32)
