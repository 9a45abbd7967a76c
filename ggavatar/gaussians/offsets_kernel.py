"""The operator ⊕ of Eq. 12 and its gradient, sixteen Gaussians at a time (compiled).

The torch twin is `offsets.refine_in_torch`.
"""

from __future__ import annotations

import numpy as np

from ggavatar.gaussians.binding_kernel import CHUNK, Floats, GeometryArrays, as_pointers, inverse_lengths
from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import gather_rows, load_rows, pointer, store_columns, store_rows_10, take_ticket, transpose
from ggavatar.jit.quaternions import conjugate, normalize_backward, product, scaled
from ggavatar.jit.simd import LANES, exp, fma, splat
from ggavatar.jit.threads import run_workers
from ggavatar.jit.vectors import columns_3, columns_4


@kernel
def refine_chunks(tickets, bound, offsets, unit, refined):
    """Refine chunks of Gaussians until none is left."""
    count, width = offsets.shape
    bound, offsets, refined = as_pointers(bound), pointer(offsets, 0), as_pointers(refined)
    first = take_ticket(tickets, 0) * CHUNK
    while first < count:
        for begin in range(first, min(first + CHUNK, count), LANES):
            found = columns_10(offsets, begin, count - 1, width)
            refine_group(bound, found, unit, begin, count - 1, refined)
        first = take_ticket(tickets, 0) * CHUNK


@inlined
def refine_group(bound, offsets, unit, first, last, refined):
    """Means + unit·Δμ, the rotation (1, 0, 0, 0) + Δr from the left, scales · exp(Δs)."""
    m, s = columns_3(bound.means, first, last), columns_3(bound.scales, first, last)
    means = fma(offsets[0], unit, m[0]), fma(offsets[1], unit, m[1]), fma(offsets[2], unit, m[2])
    store_columns(refined.means, first * 3, means)
    scales = s[0] * exp(offsets[7]), s[1] * exp(offsets[8]), s[2] * exp(offsets[9])
    store_columns(refined.scales, first * 3, scales)
    turn = (offsets[3] + np.float32(1), offsets[4], offsets[5], offsets[6])
    rotation = scaled(turn, inverse_lengths(turn))
    store_columns(refined.quats, first * 4, product(rotation, columns_4(bound.quats, first, last)))


@kernel
def backward_chunks(tickets, bound, offsets, unit, upstream, gradient, to_offsets):
    """Gradients with respect to quaternions, scales and offsets of chunks of Gaussians until none is left.

    The gradient with respect to the means is the upstream one. Color columns of the offsets are left alone.
    """
    count, width = offsets.shape
    bound, offsets, upstream = as_pointers(bound), pointer(offsets, 0), as_pointers(upstream)
    gradient, to_offsets = as_pointers(gradient), pointer(to_offsets, 0)
    first = take_ticket(tickets, 0) * CHUNK
    while first < count:
        for begin in range(first, min(first + CHUNK, count), LANES):
            rows, found = (begin, count - 1), columns_10(offsets, begin, count - 1, width)
            columns = backward_group(bound, found, unit, rows, upstream, gradient)
            store_rows_10(to_offsets, begin, count - 1, width, 0, transpose(columns))
        first = take_ticket(tickets, 0) * CHUNK


@inlined
def backward_group(bound, offsets, unit, rows, upstream, gradient):
    """Write the gradients of quaternions and scales; return those of the ten offsets, padded to sixteen with zeros."""
    (first, last), zero = rows, splat(np.float32(0))
    m, g = columns_3(upstream.means, first, last), columns_3(upstream.scales, first, last)
    s = columns_3(bound.scales, first, last)
    grown = g[0] * exp(offsets[7]), g[1] * exp(offsets[8]), g[2] * exp(offsets[9])
    store_columns(gradient.scales, first * 3, grown)
    turn = (offsets[3] + np.float32(1), offsets[4], offsets[5], offsets[6])
    inverse, g4 = inverse_lengths(turn), columns_4(upstream.quats, first, last)
    rotation = scaled(turn, inverse)
    store_columns(gradient.quats, first * 4, product(conjugate(rotation), g4))
    to_rotation = product(g4, conjugate(columns_4(bound.quats, first, last)))
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
    if first + LANES <= last:  # one more row, so that sixteen numbers of each can be read
        return transpose(load_rows(array, first, last, width, 0))[0:10]
    a, b = gather_rows(array, first, last, width, 0), gather_rows(array, first, last, width, 1)
    c, d = gather_rows(array, first, last, width, 2), gather_rows(array, first, last, width, 3)
    e, f = gather_rows(array, first, last, width, 4), gather_rows(array, first, last, width, 5)
    g, h = gather_rows(array, first, last, width, 6), gather_rows(array, first, last, width, 7)
    return a, b, c, d, e, f, g, h, gather_rows(array, first, last, width, 8), gather_rows(array, first, last, width, 9)


def refine(bound: GeometryArrays, offsets: Floats, unit: float, refined: GeometryArrays) -> None:
    """Write the refined geometry of all Gaussians; `refined` has room for a multiple of sixteen rows."""
    run_workers(refine_chunks, -(-len(offsets) // CHUNK), bound, offsets, np.float32(unit), refined)


def backward(
    bound: GeometryArrays,
    offsets: Floats,
    unit: float,
    upstream: GeometryArrays,
    gradient: GeometryArrays,
    to_offsets: Floats,
) -> None:
    """Write the gradients of all Gaussians except `gradient.means`; it has room for a multiple of sixteen rows."""
    pieces = -(-len(offsets) // CHUNK)
    run_workers(backward_chunks, pieces, bound, offsets, np.float32(unit), upstream, gradient, to_offsets)
