"""The procedural head's skin as a smooth union of primitives, and ray casting onto it.

A primitive is a capsule with two radii (an ellipsoid when both ends coincide), stretched along x, y and z.
Lengths in m, FLAME's axes. Positions follow common adult anthropometry (head 152 mm wide, 195 mm deep, eyes 62 mm
apart, mouth 50 mm wide).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

Point = tuple[float, float, float]
EYE_CENTER: Point = (0.0314, 0.0240, 0.0256)
EYE_RADIUS = 0.0124
LID_THICKNESS = 0.0013
HEAD_CENTER: Point = (0.0, 0.012, -0.030)
_MIDLINE_SOFTNESS = 0.0012
_THROAT, _NECK_BASE, LOWEST = 0.95, 1.40, 1.49


@dataclass(frozen=True)
class Primitive:
    """A stretched capsule with two radii, mirrored at x = 0.

    Attributes:
        start: First end of the capsule, m.
        end: Second end; equal to `start` for an ellipsoid.
        radii: Radius at the two ends before stretching, m.
        stretch: Factors along x, y and z.
        blend: Width of the transition to the primitives before it, m.
        cut: Subtract it instead of adding it.
    """

    start: Point
    end: Point
    radii: tuple[float, float]
    blend: float
    stretch: Point = (1.0, 1.0, 1.0)
    cut: bool = False

    def distance(self, points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
        """Approximate signed distance, negative inside, m; its magnitude never exceeds that of the true distance."""
        scale = np.asarray(self.stretch)
        local, start, end = points / scale, np.asarray(self.start) / scale, np.asarray(self.end) / scale
        axis = end - start
        length = float(axis @ axis)
        along = np.clip((local - start) @ axis / length, 0.0, 1.0) if length > 1e-12 else np.zeros(len(points))
        radius = self.radii[0] + (self.radii[1] - self.radii[0]) * along
        return (np.linalg.norm(local - start - along[:, None] * axis, axis=1) - radius) * scale.min()


def _ellipsoid(center: Point, radii: Point, blend: float, *, cut: bool = False) -> Primitive:
    """An ellipsoid as a stretched ball."""
    size = min(radii)
    return Primitive(center, center, (size, size), blend, (radii[0] / size, radii[1] / size, radii[2] / size), cut)


_EYE_X, _EYE_Y, _EYE_Z = EYE_CENTER
_LID = EYE_RADIUS + LID_THICKNESS

SKULL = (
    _ellipsoid((0.0, 0.047, -0.036), (0.0740, 0.081, 0.089), 0.02),
    _ellipsoid((0.0, 0.036, -0.058), (0.0720, 0.074, 0.070), 0.02),
    _ellipsoid((0.0, -0.020, -0.008), (0.0515, 0.078, 0.0560), 0.022),
    _ellipsoid((0.0, 0.066, -0.006), (0.0520, 0.040, 0.0500), 0.03),
    Primitive((0.059, 0.006, -0.030), (0.055, -0.030, -0.026), (0.011, 0.012), 0.022),
    _ellipsoid((0.0480, -0.010, -0.002), (0.0145, 0.034, 0.027), 0.020),
)
NECK = (
    Primitive((0.0, -0.050, -0.050), (0.0, -0.165, -0.058), (0.0485, 0.0525), 0.020, (1.0, 1.0, 1.04)),
    Primitive((0.040, -0.035, -0.046), (0.010, -0.150, -0.008), (0.012, 0.010), 0.022),
    Primitive((0.0, -0.108, -0.012), (0.0, -0.130, -0.012), (0.009, 0.007), 0.018),
)
JAW = (
    Primitive((0.0435, -0.044, -0.018), (0.0120, -0.0770, 0.0335), (0.0130, 0.0118), 0.022),
    Primitive((0.0, -0.0755, 0.0365), (0.0, -0.0755, 0.0365), (0.0150, 0.0150), 0.014, (1.12, 0.92, 1.0)),
    _ellipsoid((0.0, -0.0600, 0.0090), (0.034, 0.022, 0.034), 0.02),
)
CHEEKS = (
    _ellipsoid((0.0430, 0.0000, 0.0150), (0.0220, 0.0130, 0.0170), 0.022),
    _ellipsoid((0.0320, -0.0190, 0.0215), (0.0210, 0.0210, 0.0180), 0.018),
    _ellipsoid((0.0325, -0.0400, 0.0080), (0.0200, 0.0240, 0.0200), 0.020),
    _ellipsoid((0.0, -0.0420, 0.0290), (0.0280, 0.0240, 0.0225), 0.014),
)
BROWS = (
    Primitive((0.0080, 0.0385, 0.0385), (0.0400, 0.0425, 0.0235), (0.0074, 0.0066), 0.016),
    Primitive((0.0, 0.0400, 0.0395), (0.0, 0.0400, 0.0395), (0.0080, 0.0080), 0.018),
)
EYES = (
    _ellipsoid((0.0300, 0.0245, 0.0490), (0.0200, 0.0105, 0.0130), 0.013, cut=True),
    _ellipsoid((0.0125, 0.0230, 0.0480), (0.0060, 0.0080, 0.0080), 0.010, cut=True),
    Primitive((_EYE_X, _EYE_Y, _EYE_Z), (_EYE_X, _EYE_Y, _EYE_Z), (_LID, _LID), 0.0045),
    Primitive((0.0200, 0.0335, 0.0325), (0.0430, 0.0325, 0.0255), (0.0042, 0.0046), 0.006),
)
NOSE = (
    Primitive((0.0, 0.0270, 0.0390), (0.0, 0.0080, 0.0500), (0.0060, 0.0074), 0.011, (0.92, 1.0, 1.0)),
    Primitive((0.0, 0.0100, 0.0490), (0.0, -0.0120, 0.0625), (0.0066, 0.0084), 0.007),
    Primitive((0.0, -0.0125, 0.0630), (0.0, -0.0125, 0.0630), (0.0092, 0.0092), 0.006),
    _ellipsoid((0.0, -0.0190, 0.0530), (0.0115, 0.0080, 0.0110), 0.008),
    _ellipsoid((0.0108, -0.0180, 0.0548), (0.0060, 0.0068, 0.0090), 0.0045),
    Primitive((0.0, -0.0190, 0.0600), (0.0, -0.0270, 0.0545), (0.0044, 0.0036), 0.005),
    _ellipsoid((0.0068, -0.0278, 0.0575), (0.0034, 0.0050, 0.0056), 0.0030, cut=True),
    Primitive((0.0180, -0.0130, 0.0520), (0.0172, -0.0230, 0.0500), (0.0014, 0.0012), 0.006, cut=True),
)
LIPS = (
    Primitive((0.0, -0.0290, 0.0590), (0.0, -0.0365, 0.0585), (0.0022, 0.0024), 0.004, (1.1, 1.0, 1.0), cut=True),
    Primitive((0.0035, -0.0412, 0.0520), (0.0140, -0.0426, 0.0480), (0.0046, 0.0040), 0.0040),
    Primitive((0.0140, -0.0426, 0.0480), (0.0240, -0.0462, 0.0385), (0.0040, 0.0020), 0.0040),
    Primitive((0.0, -0.0424, 0.0535), (0.0, -0.0424, 0.0535), (0.0040, 0.0040), 0.0040),
    Primitive((0.0040, -0.0512, 0.0505), (0.0120, -0.0508, 0.0475), (0.0056, 0.0050), 0.0040),
    Primitive((0.0120, -0.0508, 0.0475), (0.0235, -0.0472, 0.0385), (0.0050, 0.0020), 0.0040),
    Primitive((0.0, -0.0645, 0.0600), (0.0120, -0.0625, 0.0570), (0.0045, 0.0020), 0.010, cut=True),
)
HEAD_PRIMITIVES: tuple[Primitive, ...] = SKULL + NECK + JAW + CHEEKS + BROWS + EYES + NOSE + LIPS


def skin_distance(
    points: Float[ndarray, "N 3"], primitives: tuple[Primitive, ...] = HEAD_PRIMITIVES
) -> Float[ndarray, " N"]:
    """Approximate signed distance of points to the skin, negative inside, m.

    The smooth union is the polynomial minimum of Quílez (2008): exact outside the transition, `blend`/4 deeper in
    its middle.
    """
    folded = points.copy()
    folded[:, 0] = np.sqrt(folded[:, 0] ** 2 + _MIDLINE_SOFTNESS**2) - _MIDLINE_SOFTNESS
    total = primitives[0].distance(folded)
    for primitive in primitives[1:]:
        other = primitive.distance(folded)
        total = (
            -_smooth_minimum(-total, other, primitive.blend)
            if primitive.cut
            else _smooth_minimum(total, other, primitive.blend)
        )
    return total


def _smooth_minimum(first: ndarray, second: ndarray, width: float) -> ndarray:
    mix = np.clip(0.5 + 0.5 * (second - first) / width, 0.0, 1.0)
    return second + (first - second) * mix - width * mix * (1.0 - mix)


def cast_rays(
    directions: Float[ndarray, "N 3"], primitives: tuple[Primitive, ...] = HEAD_PRIMITIVES
) -> Float[ndarray, "N 3"]:
    """The skin point of each unit direction of the parameter sphere, by sphere tracing, m.

    Directions above the chin are rays from the head's center. Below the chin the origin slides down the neck and the
    ray levels out, so that rays do not graze throat and neck; the last degrees before the south pole bend outwards to
    form the shoulders.
    """
    origin, ray = _rays(directions)
    travelled = np.zeros(len(directions))
    active = np.arange(len(directions))
    for _ in range(48):
        step = -skin_distance(origin[active] + travelled[active, None] * ray[active], primitives)
        travelled[active] += step
        active = active[np.abs(step) > 1e-5]
    return origin + travelled[:, None] * ray + _shoulder_offset(directions)


def _descent(directions: ndarray) -> ndarray:
    """How far down a direction lies: 0 above the throat, 1 at the base of the neck, 2 at the edge of the shoulders."""
    elevation = -np.arcsin(np.clip(directions[:, 1], -1.0, 1.0))
    return np.interp(elevation, [_THROAT, _NECK_BASE, LOWEST], [0.0, 1.0, 2.0])


def _rays(directions: ndarray) -> tuple[ndarray, ndarray]:
    """Origin and unit direction of the rays."""
    elevation = np.arcsin(np.clip(directions[:, 1], -1.0, 1.0))
    below = np.minimum(_descent(directions), 1.0)
    target = np.where(below > 0, -_THROAT + (_THROAT - 0.1) * below**1.7, elevation)
    heading = np.arctan2(directions[:, 0], directions[:, 2])
    ray = np.stack((np.cos(target) * np.sin(heading), np.sin(target), np.cos(target) * np.cos(heading)), axis=1)
    slide = 0.150 * below
    origin = np.asarray(HEAD_CENTER) + np.stack((np.zeros_like(slide), -slide, -0.18 * slide), axis=1)
    return origin, ray


def _shoulder_offset(directions: ndarray) -> ndarray:
    """Offset from the base of the neck to the shoulders, m: down and outwards, most along x."""
    along = np.clip(_descent(directions) - 1.0, 0.0, 1.0)
    flat = directions[:, [0, 2]] / np.maximum(np.linalg.norm(directions[:, [0, 2]], axis=1, keepdims=True), 1e-9)
    sideways = flat[:, 0] ** 2
    outwards = along**1.5 * (0.014 + 0.075 * sideways)
    down = along * (0.048 - 0.014 * sideways)
    return np.stack((flat[:, 0] * outwards, -down, flat[:, 1] * outwards), axis=1)
