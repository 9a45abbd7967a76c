"""Glasses and a knitted hat for the generic head; the caller warps them to the person's identity."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.head.procedural.parts import Part, grid_faces
from ggavatar.head.procedural.surface import EYE_CENTER, SKULL, cast_rays

_LENS_Z, _TUBE = 0.0560, 0.0013


def tube(path: Float[ndarray, "N 3"], radius: float, *, closed: bool, sides: int = 8) -> Part:
    """A round tube along a polyline, m."""
    following, before = np.roll(path, -1, axis=0), np.roll(path, 1, axis=0)
    if not closed:
        following[-1], before[0] = path[-1], path[0]
    tangent = following - before
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.cross(tangent, (0.12, 0.35, 0.93))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(tangent, across)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.cos(angle)[None, :, None] * across[:, None] + np.sin(angle)[None, :, None] * other[:, None]
    points = path[:, None] + radius * ring
    points = np.concatenate((points, points[:1])) if closed else points
    return Part(points.reshape(-1, 3), grid_faces(len(points), sides, closed=True))


def merged(parts: list[Part]) -> Part:
    """Several parts as one."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Part(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=True)]),
    )


def _rim(sign: float) -> Float[ndarray, "N 3"]:
    """Outline of one lens, a rounded panto shape with a slight wrap."""
    angle = np.arange(48) * 2 * np.pi / 48
    x = 0.0232 * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.75
    y = np.where(np.sin(angle) > 0, 0.0185, 0.0205) * np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** 0.8
    z = _LENS_Z - 0.12 * y - 5.0 * (np.maximum(x + 0.012, 0.0)) ** 2
    return np.stack((sign * (EYE_CENTER[0] + 0.0022 + x), EYE_CENTER[1] - 0.0030 + y, z), axis=1)


def glasses_frame() -> Part:
    """The frame of the glasses: rims, bridge and temples."""
    parts = []
    for sign in (1.0, -1.0):
        rim = _rim(sign)
        parts.append(tube(rim, _TUBE, closed=True))
        hinge = rim[np.argmax(sign * rim[:, 0])] + (sign * 0.001, 0.006, 0.0)
        bend = np.array([sign * 0.0720, 0.0300, 0.0120])
        ear = np.array([sign * 0.0755, 0.0300, -0.0270])
        tip = np.array([sign * 0.0745, 0.0050, -0.0430])
        knots = np.stack((hinge, 0.5 * (hinge + bend) + (sign * 0.006, 0.0, 0.0), bend, ear, tip))
        path = np.stack([np.interp(np.linspace(0, 4, 24), np.arange(5), knots[:, axis]) for axis in range(3)], axis=1)
        parts.append(tube(path, _TUBE * 0.95, closed=False))
    share = np.linspace(-1, 1, 9)
    inner = np.min(np.abs(_rim(1.0)[:, 0]))
    bridge = np.stack(
        (share * (inner + 0.0005), 0.0285 + 0.0022 * (1 - share**2), _LENS_Z + 0.0006 + 0.0015 * (1 - share**2)), axis=1
    )
    parts.append(tube(bridge, _TUBE, closed=False))
    return merged(parts)


def lenses() -> Part:
    """Both lenses as slightly domed disks."""
    parts = []
    for sign in (1.0, -1.0):
        rim = _rim(sign)
        middle = rim.mean(axis=0)
        rings = [middle + share * (rim - middle) + (0, 0, 0.0012 * (1 - share**2)) for share in (0.02, 0.35, 0.7, 1.0)]
        faces: Int[ndarray, "F 3"] = grid_faces(len(rings), len(rim), closed=True)
        parts.append(Part(np.concatenate(rings), faces if sign < 0 else faces[:, ::-1]))
    return merged(parts)


def beanie() -> tuple[Part, Float[ndarray, "V 2"]]:
    """A knitted hat with a turned-up brim, and texture coordinates of its vertices."""
    around, levels = 96, 30
    heading = np.linspace(0, 2 * np.pi, around + 1)
    rise = np.linspace(0, 1, levels)
    low = 0.62 - 0.36 * (0.5 - 0.5 * np.cos(heading))
    elevation = low[None] + rise[:, None] ** 0.9 * (np.pi / 2 - 0.01 - low[None])
    direction = np.stack(
        (np.cos(elevation) * np.sin(heading), np.sin(elevation), np.cos(elevation) * np.cos(heading)), axis=-1
    )
    skull = cast_rays(direction.reshape(-1, 3), SKULL).reshape(levels, around + 1, 3)
    outwards = skull - (0.0, 0.03, -0.035)
    outwards /= np.linalg.norm(outwards, axis=-1, keepdims=True)
    brim = np.interp(rise, [0.0, 0.02, 0.05, 0.25, 0.30, 0.34], [0.004, 0.0085, 0.0125, 0.0130, 0.0115, 0.0085])
    slack = 0.012 * np.clip(rise - 0.45, 0, 1) ** 1.5
    points = skull + outwards * (brim + slack)[:, None, None]
    ends = np.stack(np.meshgrid(heading / (2 * np.pi), rise), axis=-1).reshape(-1, 2)
    return Part(points.reshape(-1, 3), grid_faces(levels, around + 1)), ends
