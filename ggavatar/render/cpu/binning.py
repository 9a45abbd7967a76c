"""Which Gaussians touch which tile, front to back: one radix sort of depths, then a stable counting sort into tiles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import float_bits, pointer, prefetch
from ggavatar.render.cpu.projection import DEPTH, RECORD

DIGIT_BITS = 11
DIGITS = 1 << DIGIT_BITS
AHEAD = 32
"""How many Gaussians ahead their boxes are asked for."""


class Bins(NamedTuple):
    """Lists of Gaussians per tile.

    `starts` [tiles + 1] into `entries` [M, 2]: a Gaussian, front to back, and the slot of its gradient in this
    tile. The slots of Gaussian i are `slots[i]` … `slots[i + 1]`: sums over its tiles then read memory in
    order.
    """

    starts: np.ndarray
    entries: np.ndarray
    slots: np.ndarray


@inlined
def bare_bins(bins):
    """The bins with pointers instead of arrays."""
    return Bins(pointer(bins.starts, 0), pointer(bins.entries, 0), pointer(bins.slots, 0))


@inlined
def box_of(boxes, index):
    """Left, top, right and bottom tile of a Gaussian."""
    place = index * 4
    return np.int64(boxes[place]), np.int64(boxes[place + 1]), np.int64(boxes[place + 2]), np.int64(boxes[place + 3])


@kernel
def count_tiles(boxes, tiles_x, starts, slots):
    """Running sums of the Gaussians of every tile and of the tiles of every Gaussian; returns how many are visible."""
    starts[:] = 0
    seen, running = 0, 0
    for index in range(slots.size - 1):
        left, top, right, bottom = box_of(boxes, index)
        slots[index] = running
        if right > left and bottom > top:
            seen += 1
            running += (right - left) * (bottom - top)
            for y in range(top, bottom):
                for tile in range(y * tiles_x + left, y * tiles_x + right):
                    starts[tile + 1] += 1
    slots[slots.size - 1] = running
    for tile in range(1, starts.size):
        starts[tile] += starts[tile - 1]
    return seen


@kernel
def sort_by_depth(records, slots, keys, spare):
    """Indices of the visible Gaussians in the low halves of the result, front to back, equal depths in order of index.

    The keys are the bits of the depths relative to the nearest one: a head spans few of them, and two passes do.
    """
    size, nearest, farthest = 0, np.int64(1) << 40, np.int64(0)
    for index in range(slots.size - 1):
        if slots[index + 1] > slots[index]:
            bits = float_bits(records[index * RECORD + DEPTH])
            nearest, farthest = min(nearest, bits), max(farthest, bits)
            keys[size] = (bits << 32) | index
            size += 1
    shift, span = 0, farthest - nearest
    while size > 1 and (span >> shift) > 0:
        radix_pass(keys[:size], spare[:size], nearest, shift)
        keys, spare = spare, keys
        shift += DIGIT_BITS
    return keys[:size]


@inlined
def radix_pass(source, target, nearest, shift):
    """One stable pass of the radix sort, by the digit at `shift`."""
    places = np.zeros(DIGITS + 1, np.int64)
    for key in source:
        places[((((key >> 32) - nearest) >> shift) & (DIGITS - 1)) + 1] += 1
    for digit in range(DIGITS):
        places[digit + 1] += places[digit]
    for key in source:
        digit = (((key >> 32) - nearest) >> shift) & (DIGITS - 1)
        target[places[digit]] = key
        places[digit] += 1


@kernel
def fill_tiles(order, boxes, tiles_x, bins):
    """Append every Gaussian, front to back, to the lists of its tiles."""
    next_place = bins.starts[:-1].copy()
    for position in range(order.size):
        if position + AHEAD < order.size:
            later = order[position + AHEAD] & 0xFFFFFFFF
            prefetch(bins.slots, later)
            prefetch(boxes, later * 4)
        index = order[position] & 0xFFFFFFFF
        left, top, right, bottom = box_of(boxes, index)
        slot = bins.slots[index]
        for y in range(top, bottom):
            for tile in range(y * tiles_x + left, y * tiles_x + right):
                place = next_place[tile]
                next_place[tile] = place + 1
                bins.entries[2 * place] = index
                bins.entries[2 * place + 1] = slot
                slot += 1
