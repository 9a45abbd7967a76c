"""The refined ⊕ of Eq. 12 and its gradient, sixteen Gaussians at a time (compiled; twin: `offsets.refine_in_torch`)."""

from __future__ import annotations

import numpy as np

from ggavatar.gaussians.binding_kernel import CHUNK, Floats, Geometry, bare, one_over_length
from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import gather_rows, load_rows, pointer, store_columns, store_rows_10, take_ticket, transpose
from ggavatar.jit.quaternions import conjugate, normalize_backward, product, scaled
from ggavatar.jit.simd import LANES, exp, fma, splat
from ggavatar.jit.threads import run_workers
from ggavatar.jit.vectors import columns_3, columns_4


@kernel
def refine_chunks(tickets, placed, offsets, unit, refined):
    """Refine chunks of Gaussians until none is left."""
    count, width = offsets.shape
    placed, offsets, refined = bare(placed), pointer(offsets, 0), bare(refined)
    first = take_ticket(tickets, 0) * CHUNK
    while first < count:
        for begin in range(first, min(first + CHUNK, count), LANES):
            found = columns_10(offsets, begin, count - 1, width)
            refine_group(placed, found, unit, begin, count - 1, refined)
        first = take_ticket(tickets, 0) * CHUNK


@inlined
def refine_group(placed, offsets, unit, first, last, refined):
    """Means + unit·Δμ, (1, 0, 0, 0) + Δr as a turn on the left, scales · exp(Δs)."""
    m, s = columns_3(placed.means, first, last), columns_3(placed.scales, first, last)
    means = fma(offsets[0], unit, m[0]), fma(offsets[1], unit, m[1]), fma(offsets[2], unit, m[2])
    store_columns(refined.means, first * 3, means)
    scales = s[0] * exp(offsets[7]), s[1] * exp(offsets[8]), s[2] * exp(offsets[9])
    store_columns(refined.scales, first * 3, scales)
    turn = (offsets[3] + np.float32(1), offsets[4], offsets[5], offsets[6])
    rotation = scaled(turn, one_over_length(turn))
    store_columns(refined.quats, first * 4, product(rotation, columns_4(placed.quats, first, last)))


@kernel
def return_chunks(tickets, placed, offsets, unit, upstream, gradient, to_offsets):
    """Gradients by the placed quaternions and scales and by the offsets, of chunks until none is left.

    That by the placed means is the upstream one. Further columns of the offsets are left alone.
    """
    count, width = offsets.shape
    placed, offsets, upstream = bare(placed), pointer(offsets, 0), bare(upstream)
    gradient, to_offsets = bare(gradient), pointer(to_offsets, 0)
    first = take_ticket(tickets, 0) * CHUNK
    while first < count:
        for begin in range(first, min(first + CHUNK, count), LANES):
            rows, found = (begin, count - 1), columns_10(offsets, begin, count - 1, width)
            columns = return_group(placed, found, unit, rows, upstream, gradient)
            store_rows_10(to_offsets, begin, count - 1, width, 0, transpose(columns))
        first = take_ticket(tickets, 0) * CHUNK


@inlined
def return_group(placed, offsets, unit, rows, upstream, gradient):
    """Gradients by the placed quaternions and scales are written, those by the ten offsets returned, then zeros."""
    (first, last), zero = rows, splat(np.float32(0))
    m, g = columns_3(upstream.means, first, last), columns_3(upstream.scales, first, last)
    s = columns_3(placed.scales, first, last)
    grown = g[0] * exp(offsets[7]), g[1] * exp(offsets[8]), g[2] * exp(offsets[9])
    store_columns(gradient.scales, first * 3, grown)
    turn = (offsets[3] + np.float32(1), offsets[4], offsets[5], offsets[6])
    inverse, g4 = one_over_length(turn), columns_4(upstream.quats, first, last)
    rotation = scaled(turn, inverse)
    store_columns(gradient.quats, first * 4, product(conjugate(rotation), g4))
    to_rotation = product(g4, conjugate(columns_4(placed.quats, first, last)))
    to_turn = normalize_backward(to_rotation, rotation, inverse)
    return (
        m[0] * unit, m[1] * unit, m[2] * unit,
        to_turn[0], to_turn[1], to_turn[2], to_turn[3],
        grown[0] * s[0], grown[1] * s[1], grown[2] * s[2],
        zero, zero, zero, zero, zero, zero,
    )  # fmt: skip


@inlined
def columns_10(array, first, last, width):
    """The first ten columns of sixteen rows; rows beyond `last` repeat it."""
    if first + LANES <= last:  # a row more, so that sixteen numbers can be read of each
        return transpose(load_rows(array, first, last, width, 0))[0:10]
    a, b = gather_rows(array, first, last, width, 0), gather_rows(array, first, last, width, 1)
    c, d = gather_rows(array, first, last, width, 2), gather_rows(array, first, last, width, 3)
    e, f = gather_rows(array, first, last, width, 4), gather_rows(array, first, last, width, 5)
    g, h = gather_rows(array, first, last, width, 6), gather_rows(array, first, last, width, 7)
    return a, b, c, d, e, f, g, h, gather_rows(array, first, last, width, 8), gather_rows(array, first, last, width, 9)


def refine(placed: Geometry, offsets: Floats, unit: float, refined: Geometry) -> None:
    """Fill in the refined geometry of all Gaussians; its memory is for a multiple of sixteen rows."""
    run_workers(refine_chunks, -(-len(offsets) // CHUNK), placed, offsets, np.float32(unit), refined)


def give_back(
    placed: Geometry, offsets: Floats, unit: float, upstream: Geometry, gradient: Geometry, to_offsets: Floats
) -> None:
    """Fill in the gradients of all Gaussians, `gradient.means` excepted; its memory as that of `refine`."""
    pieces = -(-len(offsets) // CHUNK)
    run_workers(return_chunks, pieces, placed, offsets, np.float32(unit), upstream, gradient, to_offsets)
