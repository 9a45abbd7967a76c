"""Regions of the image: bands and painted outsides from masks, and the parts of a face from a projected head mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

_MOUTH = ("mouth", "lips")
_EYES = ("eyes", "eye_region", "left_eye_region", "right_eye_region", "left_eyeball", "right_eyeball")
VERTEX_SETS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "face": ("face", *_MOUTH, *_EYES),
        "mouth": _MOUTH,
        "eyes": _EYES,
        "scalp": ("scalp",),
        "below": ("neck", "shoulders"),
    }
)
"""Part of the image by the vertex sets of a head model that make it up; those a head has are joined."""

MESH_REGIONS = ("face", "mouth", "eyes")
"""Parts that are measured as they are; the hair is made from the others and the person's mask."""

BAND_SHARE = 0.02


def boundary_band(mask: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Band around the outline of a mask at one half: 2 % of the shorter side to either side, weights 0 and 1.

    Hair and shoulders are won and lost here. A mask without outline (empty, or the whole picture) has no band.
    """
    radius = max(1, round(min(mask.shape) * BAND_SHARE))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    inside = (mask >= 0.5).astype(np.uint8)
    edge = {"borderType": cv2.BORDER_REPLICATE}
    return (cv2.dilate(inside, disc, **edge) - cv2.erode(inside, disc, **edge)).astype(np.float32)


def fill_outside(
    image: UInt8[np.ndarray, "H W 3"], inside: Float[np.ndarray, "H W"], color: Sequence[float]
) -> UInt8[np.ndarray, "H W 3"]:
    """The image with everything outside a region (weight below one half) in one colour, sRGB in [0, 1]."""
    painted = image.copy()
    painted[inside < 0.5] = np.round(np.asarray(color) * 255)
    return painted


def hair_region(
    person: UInt8[np.ndarray, "H W"], scalp: UInt8[np.ndarray, "H W"], covered: UInt8[np.ndarray, "H W"]
) -> UInt8[np.ndarray, "H W"]:
    """Top of the person: what the person's mask has above the lower end of the visible scalp, without face and neck.

    Hair stands off the scalp, so the mesh only tells how far down to look; a hat counts as hair.

    Args:
        person: Coverage of the person.
        scalp: Visible scalp of the mesh.
        covered: Visible face, neck and shoulders of the mesh.
    """
    rows = np.flatnonzero(scalp.any(axis=1))
    hair = np.where(covered > 0, np.uint8(0), person)
    hair[rows[-1] + 1 if rows.size else 0 :] = 0
    return hair


def mesh_regions(
    points: Float[np.ndarray, "V 2"],
    depth: Float[np.ndarray, " V"],
    faces: Int[np.ndarray, "F 3"],
    vertex_sets: Mapping[str, Int[np.ndarray, " R"]],
    size: tuple[int, int],
) -> dict[str, UInt8[np.ndarray, "H W"]]:
    """Visible parts of a head mesh as masks, 255 inside.

    Triangles are painted from back to front with the set they belong to (all three corners in it), so a part hidden
    behind another one does not show. Sets may overlap: each is painted on its own.

    Args:
        points: Projected vertices, px.
        depth: Camera z of the vertices, m; triangles with a corner at or behind the camera are left out.
        faces: Vertex indices.
        vertex_sets: Vertices by name of the set.
        size: Width and height of the masks, px.

    Returns:
        Masks by name of `VERTEX_SETS` that the vertex sets can make; others are absent.
    """
    order = np.argsort(-depth[faces].mean(axis=1), kind="stable")
    drawn = faces[order]
    drawn = drawn[(depth[drawn] > 0).all(axis=1)]
    corners = np.clip(np.round((points[drawn] - 0.5) * 16), -(2**24), 2**24).astype(np.int32)
    masks = {}
    for region, names in VERTEX_SETS.items():
        members = [vertex_sets[name] for name in names if name in vertex_sets]
        if members:
            inside = np.isin(drawn, np.concatenate(members)).all(axis=1)
            masks[region] = _painted(corners, np.asarray(inside), size)
    return masks


def _painted(corners: np.ndarray, inside: np.ndarray, size: tuple[int, int]) -> UInt8[np.ndarray, "H W"]:
    mask = np.zeros((size[1], size[0]), np.uint8)
    for triangle, belongs in zip(corners, inside.tolist(), strict=True):
        cv2.fillConvexPoly(mask, triangle, 255 if belongs else 0, shift=4)
    return mask
