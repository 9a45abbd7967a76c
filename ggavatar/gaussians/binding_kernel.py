"""Binding of Gaussians to triangles and its gradient, sixteen Gaussians at a time (compiled).

The torch twin is `binding.bind_in_torch`. A triangle's record of 16 floats fills one cache line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int64
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import load, pointer, store_columns, take_ticket, transpose
from ggavatar.jit.quaternions import conjugate, from_matrix, inverse_length, normalize_backward, product, row, scaled
from ggavatar.jit.simd import LANES, exp, maximum, sqrt
from ggavatar.jit.threads import run_workers
from ggavatar.jit.vectors import columns_3, columns_4, dot

CHUNK = 2048
"""Gaussians per task."""

Floats = Float32[ndarray, "..."]
Indices = Int64[ndarray, " N"]

CENTER, QUAT, RECORD = 9, 12, 16
"""Offsets in a triangle's record of center and unit quaternion, after size times rotation (row-major); its length."""


class TriangleArrays(NamedTuple):
    """Triangles: centers [F, 3], rotations [F, 3, 3], sizes [F] and unit quaternions [F, 4]."""

    centers: Floats
    rotations: Floats
    scales: Floats
    quats: Floats


class GeometryArrays(NamedTuple):
    """Means [N, 3], quaternions [N, 4] and scales [N, 3] (logarithms in local space), or their gradients."""

    means: Floats
    quats: Floats
    scales: Floats


@kernel
def fill_records(centers, rotations, scales, records):
    """Write the records [F, 16] of all triangles."""
    for f in range(np.uint64(scales.size)):
        for axis in range(np.uint64(3)):
            records[f, np.uint64(CENTER) + axis] = centers[f, axis]
            for column in range(np.uint64(3)):
                records[f, np.uint64(3) * axis + column] = scales[f] * rotations[f, axis, column]
        quat = from_matrix(rotations, f)
        for part in range(4):
            records[f, np.uint64(QUAT + part)] = quat[part]


@kernel
def bind_chunks(tickets, local, index, records, world):
    """Bind chunks of Gaussians until none is left (GGAvatar Eq. 6–8)."""
    count = np.int64(index.size)
    local, index, records, world = as_pointers(local), pointer(index, 0), pointer(records, 0), as_pointers(world)
    first = take_ticket(tickets, 0) * CHUNK
    while first < count:
        for begin in range(first, min(first + CHUNK, count), LANES):
            bind_group(local, triangle_columns(records, index, begin, count - 1), begin, count - 1, world)
        first = take_ticket(tickets, 0) * CHUNK


@inlined
def bind_group(local, face, first, last, world):
    """Bind sixteen Gaussians."""
    m = columns_3(local.means, first, last)
    x, y, z = dot(face[0:3], m) + face[9], dot(face[3:6], m) + face[10], dot(face[6:9], m) + face[11]
    store_columns(world.means, first * 3, (x, y, z))
    own = columns_4(local.quats, first, last)
    store_columns(world.quats, first * 4, product(face[12:16], scaled(own, inverse_lengths(own))))
    across = (face[0], face[3], face[6])
    size, logs = sqrt(dot(across, across)), columns_3(local.scales, first, last)
    store_columns(world.scales, first * 3, (size * exp(logs[0]), size * exp(logs[1]), size * exp(logs[2])))


@kernel
def backward_chunks(tickets, local, index, records, upstream, world_scales, gradient):
    """Gradients with respect to the local geometry of chunks of Gaussians until none is left."""
    count = np.int64(index.size)
    local, index, records, upstream = as_pointers(local), pointer(index, 0), pointer(records, 0), as_pointers(upstream)
    world_scales, gradient = pointer(world_scales, 0), as_pointers(gradient)
    first = take_ticket(tickets, 0) * CHUNK
    while first < count:
        for begin in range(first, min(first + CHUNK, count), LANES):
            face = triangle_columns(records, index, begin, count - 1)
            backward_group(local, face, begin, count - 1, upstream, world_scales, gradient)
        first = take_ticket(tickets, 0) * CHUNK


@inlined
def backward_group(local, face, first, last, upstream, world_scales, gradient):
    """Gradients with respect to the local geometry of sixteen Gaussians."""
    g = columns_3(upstream.means, first, last)
    x, y = dot((face[0], face[3], face[6]), g), dot((face[1], face[4], face[7]), g)
    store_columns(gradient.means, first * 3, (x, y, dot((face[2], face[5], face[8]), g)))
    g, s = columns_3(upstream.scales, first, last), columns_3(world_scales, first, last)
    store_columns(gradient.scales, first * 3, (g[0] * s[0], g[1] * s[1], g[2] * s[2]))
    own = columns_4(local.quats, first, last)
    inverse = inverse_lengths(own)
    turned = product(conjugate(face[12:16]), columns_4(upstream.quats, first, last))
    store_columns(gradient.quats, first * 4, normalize_backward(turned, scaled(own, inverse), inverse))


@inlined
def as_pointers(geometry):
    """The geometry as pointers."""
    return GeometryArrays(pointer(geometry.means, 0), pointer(geometry.quats, 0), pointer(geometry.scales, 0))


@inlined
def inverse_lengths(quats):
    """`quaternions.inverse_length` of sixteen quaternions."""
    w, x, y, z = quats
    return np.float32(1) / maximum(sqrt(w * w + x * x + y * y + z * z), np.float32(1e-12))


@inlined
def triangle_columns(records, index, first, last):
    """The triangle records of sixteen Gaussians as 16 vectors; Gaussians beyond `last` repeat it."""
    return transpose(
        (
            face(records, index, first, last), face(records, index, first + 1, last),
            face(records, index, first + 2, last), face(records, index, first + 3, last),
            face(records, index, first + 4, last), face(records, index, first + 5, last),
            face(records, index, first + 6, last), face(records, index, first + 7, last),
            face(records, index, first + 8, last), face(records, index, first + 9, last),
            face(records, index, first + 10, last), face(records, index, first + 11, last),
            face(records, index, first + 12, last), face(records, index, first + 13, last),
            face(records, index, first + 14, last), face(records, index, first + 15, last),
        )
    )  # fmt: skip


@inlined
def face(records, index, n, last):
    """The triangle record of one Gaussian."""
    return load(records, index[min(n, last)] * RECORD)


@kernel
def add_to_faces(local, index, faces, upstream, world_scales, gradient):
    """Add the gradients of the triangles to `gradient`, in the order of the Gaussians."""
    for n in range(np.uint64(index.size)):
        f = np.uint64(index[n])
        size, m, g = faces.scales[f], local.means[n], upstream.means[n]
        for axis in range(3):
            r = faces.rotations[f, axis]
            gradient.centers[f, axis] += g[axis]
            gradient.scales[f] += g[axis] * (r[0] * m[0] + r[1] * m[1] + r[2] * m[2])
            gradient.scales[f] += upstream.scales[n, axis] * world_scales[n, axis] / size
            for column in range(3):
                gradient.rotations[f, axis, column] += size * g[axis] * m[column]
        own = row(local.quats, n)
        turned = product(row(upstream.quats, n), conjugate(scaled(own, inverse_length(own))))
        for part in range(4):
            gradient.quats[f, part] += turned[part]


def triangle_records(frames: tuple[Floats, Floats, Floats], quats: Floats | None) -> Floats:
    """Records [F, 16] from centers, rotations and sizes; quaternions follow from the rotations unless given."""
    records = np.empty((len(frames[0]), RECORD), np.float32)
    fill_records(*frames, records)
    if quats is not None:
        records[:, QUAT:] = quats
    return records


def record_quats(records: Floats) -> Floats:
    """The quaternions [F, 4] of the records."""
    return np.ascontiguousarray(records[:, QUAT:])


def bind(local: GeometryArrays, index: Indices, records: Floats, world: GeometryArrays) -> None:
    """Write the world geometry of all Gaussians; `world` has room for a multiple of sixteen rows."""
    run_workers(bind_chunks, -(-len(index) // CHUNK), local, index, records, world)


def backward(
    local: GeometryArrays,
    index: Indices,
    records: Floats,
    upstream: GeometryArrays,
    world_scales: Floats,
    gradient: GeometryArrays,
) -> None:
    """Write the gradients with respect to the local geometry; `gradient` has room for a multiple of sixteen rows."""
    run_workers(backward_chunks, -(-len(index) // CHUNK), local, index, records, upstream, world_scales, gradient)
