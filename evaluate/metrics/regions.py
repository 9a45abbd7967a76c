"""Image regions: boundary bands and fills from masks, and parts of the face from a projected head mesh."""

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
"""Vertex sets of a head model that make up each region; those that a head has are joined."""

MESH_REGIONS = ("face", "mouth", "eyes")
"""Regions measured as they are; hair is derived from the others and the person's mask."""

BAND_FRACTION = 0.02
"""Half width of the boundary band, as a fraction of the shorter image side."""


def boundary_band(mask: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Band around the outline of a mask thresholded at 0.5: 2 % of the shorter side on each side, weights 0 and 1.

    It shows errors of hair and shoulders. A mask without an outline (empty or full) has no band.
    """
    radius = max(1, round(min(mask.shape) * BAND_FRACTION))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    inside = (mask >= 0.5).astype(np.uint8)
    edge = {"borderType": cv2.BORDER_REPLICATE}
    return (cv2.dilate(inside, disc, **edge) - cv2.erode(inside, disc, **edge)).astype(np.float32)


def fill_outside(
    image: UInt8[np.ndarray, "H W 3"], inside: Float[np.ndarray, "H W"], color: Sequence[float]
) -> UInt8[np.ndarray, "H W 3"]:
    """The image with everything outside a region (weight below 0.5) in one color, sRGB in [0, 1]."""
    painted = image.copy()
    painted[inside < 0.5] = np.round(np.asarray(color) * 255)
    return painted


def hair_region(
    person: UInt8[np.ndarray, "H W"], scalp: UInt8[np.ndarray, "H W"], covered: UInt8[np.ndarray, "H W"]
) -> UInt8[np.ndarray, "H W"]:
    """Hair: the person's mask down to the lowest visible scalp row, without face and neck.

    Hair stands off the scalp, so the mesh only bounds it from below; a hat counts as hair.

    Args:
        person: Person mask, 255 inside.
        scalp: Visible scalp of the mesh, non-zero inside.
        covered: Visible face, neck and shoulders of the mesh, non-zero inside.
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

    Triangles are drawn from back to front; one belongs to a region if all its corners do, so occluded parts do not
    show. Regions may overlap: each is drawn on its own.

    Args:
        points: Projected vertices, px.
        depth: Camera z of the vertices, m; triangles with a corner at or behind the camera are skipped.
        faces: Vertex indices.
        vertex_sets: Vertex indices by name of the set.
        size: Width and height of the masks, px.

    Returns:
        Masks by region of `VERTEX_SETS`; regions without any of their vertex sets are absent.
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
