"""Texture layout of the procedural head: the skin as a cylinder at the top, islands for the other parts below.

Texture coordinates are in [0, 1], u to the right and v upward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

_SKIN_LOW, _SKIN_MARGIN = 0.22, 0.03


@dataclass(frozen=True)
class _Island:
    """A rectangle of the texture (left, bottom, width, height), and the axes of the part that run along u and v."""

    box: tuple[float, float, float, float]
    axes: tuple[int, int]


_ISLANDS = {
    "left_eyeball": _Island((0.01, 0.01, 0.11, 0.19), (0, 1)),
    "right_eyeball": _Island((0.13, 0.01, 0.11, 0.19), (0, 1)),
    "mouth_bag": _Island((0.25, 0.01, 0.20, 0.19), (0, 1)),
    "upper_teeth": _Island((0.46, 0.11, 0.16, 0.09), (0, 1)),
    "lower_teeth": _Island((0.46, 0.01, 0.16, 0.09), (0, 1)),
    "tongue": _Island((0.63, 0.01, 0.11, 0.19), (0, 2)),
    "left_ear": _Island((0.75, 0.01, 0.11, 0.19), (2, 1)),
    "right_ear": _Island((0.87, 0.01, 0.11, 0.19), (2, 1)),
}


def unwrap(
    points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], groups: dict[str, Int[ndarray, " R"]]
) -> Float[ndarray, "F 3 2"]:
    """Texture coordinates of every face corner.

    The skin's seam runs down the back. Front and back of the other parts share their texels.
    """
    angle = np.arctan2(points[:, 0], points[:, 2] + 0.030) / (2 * np.pi)
    height = _skin_height(points)
    flat = np.stack((angle, height), axis=1)
    corners = flat[faces]
    wrapped = (corners[..., 0].max(axis=1) - corners[..., 0].min(axis=1)) > 0.5
    corners[wrapped, :, 0] = np.where(corners[wrapped, :, 0] < 0, corners[wrapped, :, 0] + 1, corners[wrapped, :, 0])
    corners[..., 0] = np.clip(0.5 + (0.5 - _SKIN_MARGIN) * 2 * corners[..., 0], 0.0, 1.0)
    corners[..., 1] = _SKIN_LOW + (1 - _SKIN_LOW) * corners[..., 1]
    for name, island in _ISLANDS.items():
        rows = groups[name]
        chosen = np.isin(faces, rows).all(axis=1)
        seen = points[:, island.axes]
        low, high = seen[rows].min(axis=0), seen[rows].max(axis=0)
        box = np.asarray(island.box)
        corners[chosen] = (box[:2] + (seen - low) / (high - low) * box[2:])[faces[chosen]]
    return corners


def _skin_height(points: ndarray) -> ndarray:
    """Height in the texture in [0, 1], measured along the profile: by angle on the dome of the skull, by y below it."""
    radius = np.hypot(points[:, 0], points[:, 2] + 0.030)
    dome = 0.045 + 0.085 * np.arctan2(np.maximum(points[:, 1] - 0.045, 0.0), radius)
    run = np.where(points[:, 1] > 0.045, dome, points[:, 1])
    run = run - np.where(points[:, 1] < -0.13, 0.35 * np.maximum(radius - 0.055, 0.0), 0.0)
    low, high = run.min(), 0.045 + 0.085 * np.pi / 2
    return (run - low) / (high - low)
