"""The refined ⊕ of Eq. 12 and its gradient (compiled; twin: `deform.refine_in_torch`)."""

from __future__ import annotations

import numpy as np

from ggavatar.binding_kernel import CHUNK, Floats, Geometry
from ggavatar.compiled import kernel, run
from ggavatar.quaternions import conjugate, inverse_length, product, put, row, scaled, through_normalisation


@kernel
def refine_range(placed, offsets, unit, first, last, refined):
    """Gaussians `first` … `last` − 1: means + unit·Δμ, (1, 0, 0, 0) + Δr as a turn on the left, scales · exp(Δs)."""
    one = np.float32(1)
    for n in range(np.uint64(first), np.uint64(last)):
        for axis in range(np.uint64(3)):
            refined.means[n, axis] = placed.means[n, axis] + unit * offsets[n, axis]
            refined.scales[n, axis] = placed.scales[n, axis] * np.exp(offsets[n, axis + np.uint64(7)])
        turn = (one + offsets[n, 3], offsets[n, 4], offsets[n, 5], offsets[n, 6])
        put(refined.quats, n, product(scaled(turn, inverse_length(turn)), row(placed.quats, n)))


@kernel
def return_range(placed, offsets, unit, first, last, upstream, gradient, to_offsets):
    """Gradients by the placed geometry and by the offsets (whose further columns are left alone)."""
    one = np.float32(1)
    for n in range(np.uint64(first), np.uint64(last)):
        for axis in range(np.uint64(3)):
            g, growth = upstream.scales[n, axis], np.exp(offsets[n, axis + np.uint64(7)])
            gradient.means[n, axis] = upstream.means[n, axis]
            gradient.scales[n, axis] = g * growth
            to_offsets[n, axis] = unit * upstream.means[n, axis]
            to_offsets[n, axis + np.uint64(7)] = g * growth * placed.scales[n, axis]
        turn = (one + offsets[n, 3], offsets[n, 4], offsets[n, 5], offsets[n, 6])
        inverse = inverse_length(turn)
        rotation, g4 = scaled(turn, inverse), row(upstream.quats, n)
        put(gradient.quats, n, product(conjugate(rotation), g4))
        to_rotation = product(g4, conjugate(row(placed.quats, n)))
        to_turn = through_normalisation(to_rotation, rotation, inverse)
        to_offsets[n, 3], to_offsets[n, 4], to_offsets[n, 5], to_offsets[n, 6] = to_turn


def refine(placed: Geometry, offsets: Floats, unit: float, refined: Geometry) -> None:
    """Fill in the refined geometry of all Gaussians."""
    count, factor = len(offsets), np.float32(unit)
    starts = range(0, count, CHUNK)
    run(lambda k: refine_range(placed, offsets, factor, starts[k], min(starts[k] + CHUNK, count), refined), len(starts))


def give_back(
    placed: Geometry, offsets: Floats, unit: float, upstream: Geometry, gradient: Geometry, to_offsets: Floats
) -> None:
    """Fill in the gradients of all Gaussians."""
    count, factor = len(offsets), np.float32(unit)
    starts = range(0, count, CHUNK)

    def task(k: int) -> None:
        last = min(starts[k] + CHUNK, count)
        return_range(placed, offsets, factor, starts[k], last, upstream, gradient, to_offsets)

    run(task, len(starts))
