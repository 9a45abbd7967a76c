"""Identity basis of the procedural head: smooth warps of space.

Every warp has one coefficient, whose unit is about one standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Warp:
    """A windowed affine shift, mirrored at x = 0.

    Attributes:
        name: What increases with the coefficient.
        center: Fixed point of the scaling and center of the Gaussian window on the left half, m.
        falloff: Distance along x, y and z at which the window has fallen to 1/e, m; 9 covers the whole head.
        scale: Relative growth along x, y and z about the center.
        shift: Displacement at the center, m.
        soft_only: Leaves teeth, tongue and eyeballs unchanged.
    """

    name: str
    center: Vector
    falloff: Vector
    scale: Vector = (0.0, 0.0, 0.0)
    shift: Vector = (0.0, 0.0, 0.0)
    soft_only: bool = False

    def field(self, points: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
        """Displacement of points per unit, m."""
        side = points[:, 0] / np.sqrt(points[:, 0] ** 2 + 0.004**2)
        folded = np.column_stack((np.abs(points[:, 0]), points[:, 1:]))
        offset = folded - self.center
        window = np.exp(-((offset / self.falloff) ** 2).sum(axis=1))
        change = window[:, None] * (offset * self.scale + self.shift)
        return np.column_stack((change[:, 0] * side, change[:, 1:]))


_ALL = (9.0, 9.0, 9.0)
WARPS = (
    Warp("head_width", (0.0, 0.02, -0.03), _ALL, (0.035, 0.0, 0.0)),
    Warp("head_height", (0.0, 0.024, 0.0), _ALL, (0.0, 0.035, 0.0)),
    Warp("head_depth", (0.0, 0.0, 0.02), (9.0, 9.0, 9.0), (0.0, 0.0, 0.035)),
    Warp("lower_face_length", (0.0, -0.090, 0.04), (0.09, 0.055, 0.07), shift=(0.0, -0.0040, 0.0)),
    Warp("jaw_width", (0.050, -0.055, 0.0), (0.040, 0.032, 0.05), shift=(0.0045, 0.0, 0.0), soft_only=True),
    Warp("chin_forward", (0.0, -0.078, 0.050), (0.024, 0.020, 0.03), shift=(0.0, 0.0, 0.0035), soft_only=True),
    Warp("chin_width", (0.014, -0.080, 0.045), (0.016, 0.016, 0.03), shift=(0.0030, 0.0, 0.0), soft_only=True),
    Warp("cheekbones", (0.050, 0.002, 0.020), (0.022, 0.018, 0.03), shift=(0.0030, 0.0, 0.0018), soft_only=True),
    Warp("cheek_fullness", (0.042, -0.030, 0.022), (0.020, 0.024, 0.03), shift=(0.0036, 0.0, 0.0026), soft_only=True),
    Warp("nose_length", (0.0, -0.014, 0.066), (0.016, 0.016, 0.03), shift=(0.0, -0.0006, 0.0038), soft_only=True),
    Warp("nose_width", (0.0, -0.018, 0.056), (0.024, 0.014, 0.02), (0.13, 0.0, 0.0), soft_only=True),
    Warp("nose_bridge", (0.0, 0.012, 0.052), (0.010, 0.018, 0.02), shift=(0.0, 0.0, 0.0024), soft_only=True),
    Warp("nose_tip_up", (0.0, -0.015, 0.068), (0.014, 0.012, 0.02), shift=(0.0, 0.0030, 0.0), soft_only=True),
    Warp("brow_ridge", (0.022, 0.041, 0.038), (0.026, 0.011, 0.03), shift=(0.0, -0.0008, 0.0024), soft_only=True),
    Warp("eye_distance", (0.031, 0.024, 0.030), (0.020, 0.018, 0.05), shift=(0.0016, 0.0, 0.0)),
    Warp("eye_opening", (0.031, 0.0235, 0.038), (0.018, 0.010, 0.03), (0.0, 0.15, 0.0), soft_only=True),
    Warp("eye_slant", (0.045, 0.025, 0.032), (0.010, 0.012, 0.03), shift=(0.0, 0.0016, 0.0), soft_only=True),
    Warp("mouth_width", (0.0, -0.047, 0.046), (0.040, 0.018, 0.04), (0.070, 0.0, 0.0), soft_only=True),
    Warp(
        "lip_fullness",
        (0.0, -0.0470, 0.052),
        (0.026, 0.013, 0.03),
        (0.0, 0.15, 0.0),
        shift=(0.0, 0.0, 0.0013),
        soft_only=True,
    ),
    Warp("forehead_slope", (0.0, 0.085, 0.045), (0.060, 0.030, 0.05), shift=(0.0, 0.0, -0.0040), soft_only=True),
    Warp("neck_width", (0.0, -0.125, -0.050), (0.3, 0.040, 0.3), (0.08, 0.0, 0.07), soft_only=True),
    Warp("ears_out", (0.084, 0.008, -0.036), (0.012, 0.040, 0.030), shift=(0.0045, 0.0, 0.0), soft_only=True),
)


def identity_names() -> tuple[str, ...]:
    """Names of the identity coefficients, in the order of the basis."""
    return tuple(warp.name for warp in WARPS)


def warp_points(points: Float[ndarray, "N 3"], coefficients: Float[ndarray, " I"]) -> Float[ndarray, "N 3"]:
    """Points near the generic head (accessories), moved by identity coefficients, m."""
    return points + sum(
        float(value) * warp.field(points) for warp, value in zip(WARPS, coefficients, strict=True) if value
    )


def identity_basis(points: Float[ndarray, "V 3"], rigid: dict[str, ndarray], soft: ndarray) -> Float[ndarray, "V 3 I"]:
    """Displacement per unit of every coefficient, m.

    Args:
        points: Vertices of the generic head, m.
        rigid: Vertex sets that move as a whole (the eyeballs).
        soft: Mask of skin vertices; the others ignore warps marked `soft_only`.
    """
    columns = []
    for warp in WARPS:
        change = warp.field(points)
        for rows in rigid.values():
            change[rows] = warp.field(points[rows].mean(axis=0, keepdims=True))
        columns.append(np.where(soft[:, None] | (not warp.soft_only), change, 0.0))
    return np.stack(columns, axis=2)
