"""Shoulders in a garment: a separate mesh, which does not turn with the head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

from ggavatar.head.procedural.parts import grid_faces
from preprocess.synthetic.person.description import Garment
from preprocess.synthetic.person.texture_space import noise, to_linear

_AROUND, _LEVELS, _CENTER_Z = 96, 56, -0.054
_KNOTS = np.array([0.0, 0.05, 0.10, 0.22, 0.36, 0.48, 0.60, 0.72, 0.86, 1.0])
# Distance from the neck's axis and height, m, from the inside of the collar to below the image.
_SIDE = (
    (0.050, 0.0600, 0.0660, 0.088, 0.126, 0.160, 0.186, 0.203, 0.212, 0.214),
    (-0.158, -0.138, -0.142, -0.154, -0.163, -0.174, -0.196, -0.245, -0.33, -0.46),
)
_FRONT = (
    (0.050, 0.0600, 0.0660, 0.076, 0.090, 0.102, 0.112, 0.120, 0.124, 0.124),
    (-0.180, -0.160, -0.164, -0.182, -0.200, -0.220, -0.248, -0.292, -0.36, -0.47),
)
_BACK = (
    (0.050, 0.0600, 0.0660, 0.080, 0.096, 0.108, 0.115, 0.118, 0.118, 0.116),
    (-0.150, -0.130, -0.134, -0.144, -0.158, -0.178, -0.205, -0.250, -0.33, -0.46),
)


@dataclass(frozen=True)
class Torso:
    """Garment mesh: vertices in m, triangles, and texture coordinates of every corner."""

    points: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    uv: Float[ndarray, "F 3 2"]


def build_torso(garment: Garment) -> Torso:
    """A garment mesh of rings from the collar over the shoulders to below the image."""
    share = np.linspace(0, 1, _LEVELS) ** 1.15
    heading = np.linspace(0, 2 * np.pi, _AROUND + 1)
    profiles = [[PchipInterpolator(_KNOTS, values)(share) for values in pair] for pair in (_SIDE, _FRONT, _BACK)]
    side = np.abs(np.sin(heading)) ** 1.6
    front, back = (1 - side) * (np.cos(heading) > 0), (1 - side) * (np.cos(heading) <= 0)
    radius, height = (
        sum(weight[None] * profiles[k][which][:, None] for k, weight in enumerate((side, front, back)))
        for which in (0, 1)
    )
    collar = np.exp(-((share / 0.10) ** 2))[:, None]
    opening = np.exp(-((share / 0.16) ** 2))[:, None] * front[None] ** 1.5
    height = height - garment.neckline * opening
    radius = radius + garment.neckline * 0.22 * opening
    height = height + garment.collar * collar
    fold = 0.0016 * np.sin(9 * heading + 3 * np.sin(2 * heading))[None] * np.clip(share * 3 - 0.6, 0, 1)[:, None]
    radius = radius + fold
    points = np.stack((radius * np.sin(heading), height + 0 * heading, _CENTER_Z + radius * np.cos(heading)), axis=-1)
    u, v = np.meshgrid(heading / (2 * np.pi), 1 - share)
    faces = grid_faces(_LEVELS, _AROUND + 1)[:, ::-1]
    uv = np.stack((u, v), axis=-1).reshape(-1, 2)
    return Torso(points.reshape(-1, 3), faces, uv[faces])


def paint_garment(garment: Garment, size: int, seed: int) -> tuple[Float[ndarray, "R R 3"], Float[ndarray, "R R"]]:
    """Linear color and relief in m of the garment's texture."""
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    flat = np.stack((u.ravel(), v.ravel(), np.zeros(size * size)), axis=1)
    cloth = (1 + 0.06 * noise(flat, 0.05, seed) + 0.05 * noise(flat, 0.008, seed + 1)).reshape(size, size, 1)
    color, accent = np.asarray(garment.color), np.asarray(garment.accent)
    down = 1 - v
    collar = down < 0.105
    image = np.broadcast_to(color, (size, size, 3)).copy()
    relief = 0.00006 * noise(flat, 0.004, seed + 2).reshape(size, size)
    if garment.pattern == "stripes":
        image[(down * 17 % 1.0 < 0.42) & ~collar] = accent
    if garment.pattern in ("knit", "stripes"):
        strand = np.sin(2 * np.pi * 150 * u + 1.2 * np.sin(2 * np.pi * 90 * down))
        relief = relief + np.where(collar, 0.00045 * np.sin(2 * np.pi * 110 * u), 0.00022 * strand)
        cloth = cloth * (0.94 + 0.06 * np.where(collar, np.sin(2 * np.pi * 110 * u), strand))[..., None]
    if garment.pattern == "knit":
        image[collar & (down > 0.085)] = accent
    if garment.pattern == "shirt":
        image[np.abs((u * 96) % 1.0 - 0.5) < 0.13] = accent
        front = np.minimum(u, 1 - u)
        image[(front < 0.004) & (down > 0.1)] *= 0.80
        relief = relief - 0.0008 * np.exp(-(((front - 0.018) / 0.002) ** 2)) * (down > 0.1)
    relief = relief - 0.0012 * np.exp(-(((down - 0.108) / 0.006) ** 2))
    return to_linear(image * cloth), relief.astype(np.float32)
