"""Triangle frames in one pass over the faces; compiled twin of `ggavatar.geometry.triangles.triangle_frames_torch`."""

from __future__ import annotations

import math

import numpy as np

from ggavatar.jit.kernels import inlined, kernel

MIN_LENGTH = np.float32(1e-20)
"""A vector that is not longer than this has no direction."""


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _scaled(factor, a):
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def _unit(a):
    """The vector at length 1, or zero if it has no direction, and its length."""
    length = np.float32(math.sqrt(_dot(a, a)))
    return _scaled(np.float32(1) / length if length > MIN_LENGTH else np.float32(0), a), length


@inlined
def _normal(axis, edge):
    """Unit vector perpendicular to `axis` and `edge`; any one perpendicular to `axis` if the triangle has no area."""
    normal, length = _unit(_cross(axis, edge))
    if length <= MIN_LENGTH:
        x, y, z = axis
        normal, _ = _unit(_cross(axis, (z + np.float32(0.3), x - np.float32(0.2), y + np.float32(0.1))))
    along = _dot(normal, axis)
    perpendicular = normal[0] - along * axis[0], normal[1] - along * axis[1], normal[2] - along * axis[2]
    return _unit(perpendicular)[0]


@kernel
def fill_frames(vertices, faces, centers, rotations, scales):
    """Write centers [F, 3], rotations [F, 3, 3] and sizes [F] of the triangles `faces` [F, 3] of `vertices` [V, 3]."""
    third, half = np.float32(1 / 3), np.float32(0.5)
    for face in range(faces.shape[0]):
        first, second, last = vertices[faces[face, 0]], vertices[faces[face, 1]], vertices[faces[face, 2]]
        edge_10 = second[0] - first[0], second[1] - first[1], second[2] - first[2]
        edge_20 = last[0] - first[0], last[1] - first[1], last[2] - first[2]
        axis_0, length = _unit(edge_10)
        if length <= MIN_LENGTH:
            axis_0 = np.float32(1), np.float32(0), np.float32(0)
        axis_1 = _normal(axis_0, edge_20)
        axis_2 = _cross(axis_0, axis_1)
        scales[face] = half * (length + abs(_dot(axis_2, edge_20)))
        for axis in range(3):
            centers[face, axis] = third * (first[axis] + second[axis] + last[axis])
            rotations[face, axis, 0] = axis_0[axis]
            rotations[face, axis, 1] = axis_1[axis]
            rotations[face, axis, 2] = axis_2[axis]
