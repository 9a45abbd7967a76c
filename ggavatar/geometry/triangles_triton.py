"""Triangle frames in Triton (torch twin: `ggavatar.geometry.triangles.triangle_frames_torch`)."""

from __future__ import annotations

import triton.language as tl
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import added, combined, cross, dot, load_3, scaled, store_3

BLOCK = 128
MIN_LENGTH = tl.constexpr(1e-20)
"""A vector that is not longer than this has no direction."""


@device_function
def _unit(a):
    """The vector at length 1, or zero if it has no direction, and its length."""
    length = tl.sqrt(dot(a, a))
    return scaled(tl.where(length > MIN_LENGTH, 1.0 / tl.maximum(length, MIN_LENGTH), 0.0), a), length


@device_function
def _chosen(first, a, b):
    """The vector a where `first` is true, b elsewhere."""
    return tl.where(first, a[0], b[0]), tl.where(first, a[1], b[1]), tl.where(first, a[2], b[2])


@device_function
def _normal(axis, edge):
    """Unit vector perpendicular to `axis` and `edge`; any one perpendicular to `axis` if the triangle has no area."""
    normal, length = _unit(cross(axis, edge))
    other, _ = _unit(cross(axis, (axis[2] + 0.3, axis[0] - 0.2, axis[1] + 0.1)))
    normal = _chosen(length > MIN_LENGTH, normal, other)
    return _unit(combined(1.0, normal, -dot(normal, axis), axis))[0]


@device_kernel
def place_frames(vertices, faces, centers, rotations, sizes, rows, BLOCK: tl.constexpr):
    """Write centers [F, 3], rotations [F, 3, 3] and sizes [F] of the triangles `faces` [F, 3] of `vertices` [V, 3]."""
    face = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = face < rows
    first = load_3(vertices, tl.load(faces + 3 * face, mask=alive, other=0), alive)
    second = load_3(vertices, tl.load(faces + 3 * face + 1, mask=alive, other=0), alive)
    third = load_3(vertices, tl.load(faces + 3 * face + 2, mask=alive, other=0), alive)
    edge_10, edge_20 = combined(1.0, second, -1.0, first), combined(1.0, third, -1.0, first)
    axis_0, length = _unit(edge_10)
    zero = tl.zeros_like(length)
    axis_0 = _chosen(length > MIN_LENGTH, axis_0, (zero + 1.0, zero, zero))
    axis_1 = _normal(axis_0, edge_20)
    axis_2 = cross(axis_0, axis_1)
    tl.store(sizes + face, 0.5 * (length + tl.abs(dot(axis_2, edge_20))), mask=alive)
    store_3(centers, face, alive, scaled(1 / 3, added(added(first, second), third)))
    for axis in tl.static_range(3):
        store_3(rotations, 3 * face + axis, alive, (axis_0[axis], axis_1[axis], axis_2[axis]))


def fill_frames(vertices: Tensor, faces: Tensor, centers: Tensor, rotations: Tensor, sizes: Tensor) -> None:
    """Write the frames of all triangles."""
    programs = -(-len(faces) // BLOCK)
    device_kernels.launch(place_frames, programs, vertices, faces, centers, rotations, sizes, len(faces), BLOCK=BLOCK)
