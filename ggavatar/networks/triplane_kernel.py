"""Lookup in a hash tri-plane and its gradient (compiled; torch twin: `fields.lookup_in_torch`).

Features are read point by point, one table at a time, so that a table stays in the cache. One thread sums the gradient
of a table in the order of the points: no atomics, and results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int64, UInt32
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.pairs import add_to_pairs, blend_pairs
from ggavatar.jit.threads import run

PRIME = np.uint32(2654435761)
CHUNK = 4096
"""Points per forward task."""
BLOCK = 512
"""Points read from one table before the next one; their features stay in the second-level cache."""
GROUP = 2
"""Tables per backward task."""
FEATURES = 2
"""Features per entry; other numbers use the torch twin."""

Floats = Float32[ndarray, "..."]


class Layout(NamedTuple):
    """Geometry of the tables, one element per table."""

    axes: Int64[ndarray, "K 2"]
    scale: Floats
    side: UInt32[ndarray, " K"]
    mask: UInt32[ndarray, " K"]
    first: UInt32[ndarray, " K"]


@kernel
def normalize(x, center, side, points):
    """Write positions [N, 3] as coordinates in [0, 1] within a cube to `points` [3, N]; NaN becomes 0."""
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for axis in range(3):
        middle = center[axis]
        for n in range(np.uint64(x.shape[0])):
            place = (x[n, axis] - middle) / side + half
            place = place if place > zero else zero
            points[axis, n] = place if place < one else one


@inlined
def _locate(across, down, scale, side, mask, first, entries, weights):
    """Entries and bilinear weights of the four grid vertices around points in [0, 1]²; `mask` is 0 for dense tables."""
    one, half, step = np.float32(1), np.float32(0.5), np.uint32(1)
    for n in range(np.uint64(across.size)):
        x, y = across[n] * scale + half, down[n] * scale + half
        column, row = np.int32(x), np.int32(y)  # positions are not negative, so this is the floor
        u, v = x - np.float32(column), y - np.float32(row)
        weights[0, n] = (one - u) * (one - v)
        weights[1, n] = u * (one - v)
        weights[2, n] = (one - u) * v
        weights[3, n] = u * v
        left, top = np.uint32(column), np.uint32(row)
        entries[0, n], entries[1, n] = left, top
    if mask:
        for n in range(np.uint64(across.size)):
            left, top = entries[0, n], entries[1, n] * PRIME
            entries[0, n] = first + ((left ^ top) & mask)
            entries[1, n] = first + (((left + step) ^ top) & mask)
            entries[2, n] = first + ((left ^ (top + PRIME)) & mask)
            entries[3, n] = first + (((left + step) ^ (top + PRIME)) & mask)
    else:
        for n in range(np.uint64(across.size)):
            base = first + entries[0, n] + entries[1, n] * side
            entries[0, n] = base
            entries[1, n] = base + step
            entries[2, n] = base + side
            entries[3, n] = base + side + step


@inlined
def _place(points, layout, table, begin, end, entries, weights):
    axes = layout.axes[table]
    across, down = points[axes[0], begin:end], points[axes[1], begin:end]
    _locate(
        across, down, layout.scale[table], layout.side[table], layout.mask[table], layout.first[table], entries, weights
    )


@kernel
def look_up_range(points, tables, layout, first, last, features):
    """Write rows `first` … `last` − 1 of `features`; `points` [3, N] are in [0, 1]."""
    entries, weights = np.empty((4, BLOCK), np.int32), np.empty((4, BLOCK), np.float32)
    for begin in range(first, last, BLOCK):
        end = min(begin + BLOCK, last)
        for table in range(layout.scale.size):
            _place(points, layout, table, begin, end, entries, weights)
            _gather(tables, entries, weights, features, begin * features.shape[1] + FEATURES * table, end - begin)


@inlined
def _corners(entries, weights, n):
    """Flat indices and weights of the four entries of point `n` of a block."""
    two = np.int64(FEATURES)
    flat = (two * entries[0, n], two * entries[1, n], two * entries[2, n], two * entries[3, n])
    return flat, (weights[0, n], weights[1, n], weights[2, n], weights[3, n])


@inlined
def _gather(tables, entries, weights, out, at, count):
    for n in range(count):
        flat, shares = _corners(entries, weights, n)
        blend_pairs(tables, flat, shares, out, at + n * np.int64(out.shape[1]))


@kernel
def scatter_into_tables(points, upstream, layout, first, last, gradient):
    """Add the gradients of the features of tables `first` … `last` − 1 to their entries."""
    entries, weights = np.empty((4, BLOCK), np.int32), np.empty((4, BLOCK), np.float32)
    count = points.shape[1]
    for begin in range(0, count, BLOCK):
        end = min(begin + BLOCK, count)
        for table in range(first, last):
            _place(points, layout, table, begin, end, entries, weights)
            _scatter(gradient, entries, weights, upstream, begin * upstream.shape[1] + FEATURES * table, end - begin)


@inlined
def _scatter(gradient, entries, weights, upstream, at, count):
    for n in range(count):
        flat, shares = _corners(entries, weights, n)
        add_to_pairs(gradient, flat, shares, upstream, at + n * np.int64(upstream.shape[1]))


def look_up(points: Floats, tables: Floats, layout: Layout, features: Floats) -> None:
    """Write the features of all points."""
    count = points.shape[1]
    starts = range(0, count, CHUNK)

    def task(index: int) -> None:
        look_up_range(points, tables, layout, starts[index], min(starts[index] + CHUNK, count), features)

    run(task, len(starts))


def backward(points: Floats, upstream: Floats, layout: Layout, gradient: Floats) -> None:
    """Add the gradients of all features to `gradient`, which starts as zeros."""
    count = len(layout.scale)
    starts = range(0, count, GROUP)

    def task(index: int) -> None:
        scatter_into_tables(points, upstream, layout, starts[index], min(starts[index] + GROUP, count), gradient)

    run(task, len(starts))
