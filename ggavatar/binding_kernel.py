"""Gaussians from their triangles to the world, and the gradient back (compiled; twin: `binding.bind_in_torch`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int64
from numpy import ndarray

from ggavatar.compiled import kernel, run
from ggavatar.quaternions import (
    conjugate,
    from_matrix,
    inverse_length,
    product,
    put,
    row,
    scaled,
    through_normalisation,
)

CHUNK = 8192
"""Gaussians of a task."""

Floats = Float32[ndarray, "..."]
Indices = Int64[ndarray, " N"]


class Faces(NamedTuple):
    """Triangles: centres [F, 3], rotations [F, 3, 3], sizes [F] and unit quaternions [F, 4]."""

    centers: Floats
    rotations: Floats
    scales: Floats
    quats: Floats


class Geometry(NamedTuple):
    """Means [N, 3], quaternions [N, 4] and scales [N, 3] (logarithms in local space), or gradients by them."""

    means: Floats
    quats: Floats
    scales: Floats


@kernel
def quaternions_of(rotations, quats):
    """Fill in the unit quaternions of all rotations."""
    for n in range(rotations.shape[0]):
        put(quats, n, from_matrix(rotations, n))


@kernel
def place_range(local, index, faces, first, last, world):
    """Gaussians `first` … `last` − 1 in the world (GGAvatar Eq. 6–8)."""
    for n in range(np.uint64(first), np.uint64(last)):
        f = np.uint64(index[n])
        size, m = faces.scales[f], local.means[n]
        for axis in range(3):
            r = faces.rotations[f, axis]
            world.means[n, axis] = size * (r[0] * m[0] + r[1] * m[1] + r[2] * m[2]) + faces.centers[f, axis]
            world.scales[n, axis] = size * np.exp(local.scales[n, axis])
        own = row(local.quats, n)
        put(world.quats, n, product(row(faces.quats, f), scaled(own, inverse_length(own))))


@kernel
def return_range(local, index, faces, first, last, upstream, world_scales, gradient):
    """Gradients by the local geometry of Gaussians `first` … `last` − 1."""
    for n in range(np.uint64(first), np.uint64(last)):
        f = np.uint64(index[n])
        size, g = faces.scales[f], upstream.means[n]
        for axis in range(3):
            r = faces.rotations[f]
            gradient.means[n, axis] = size * (r[0, axis] * g[0] + r[1, axis] * g[1] + r[2, axis] * g[2])
            gradient.scales[n, axis] = upstream.scales[n, axis] * world_scales[n, axis]
        own = row(local.quats, n)
        inverse = inverse_length(own)
        turned = product(conjugate(row(faces.quats, f)), row(upstream.quats, n))
        put(gradient.quats, n, through_normalisation(turned, scaled(own, inverse), inverse))


@kernel
def add_to_faces(local, index, faces, upstream, world_scales, gradient):
    """Add the gradients by the triangles to `gradient`, one Gaussian after the other."""
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


def place(local: Geometry, index: Indices, faces: Faces, world: Geometry) -> None:
    """Fill in the world's geometry of all Gaussians."""
    count = len(index)
    starts = range(0, count, CHUNK)
    run(lambda k: place_range(local, index, faces, starts[k], min(starts[k] + CHUNK, count), world), len(starts))


def give_back(
    local: Geometry, index: Indices, faces: Faces, upstream: Geometry, world_scales: Floats, gradient: Geometry
) -> None:
    """Fill in the gradients by the local geometry of all Gaussians."""
    count = len(index)
    starts = range(0, count, CHUNK)

    def task(k: int) -> None:
        last = min(starts[k] + CHUNK, count)
        return_range(local, index, faces, starts[k], last, upstream, world_scales, gradient)

    run(task, len(starts))
