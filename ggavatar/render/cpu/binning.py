"""Per-tile lists of Gaussians, front to back: a radix sort by depth, then a stable counting sort into tiles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import float_bits, pointer, prefetch
from ggavatar.render.cpu.layout import DEPTH, RECORD

DIGIT_BITS = 11
DIGITS = 1 << DIGIT_BITS
"""Values of a digit of the radix sort."""

PREFETCH_DISTANCE = 32
"""How many Gaussians ahead boxes are prefetched."""


class Bins(NamedTuple):
    """Lists of Gaussians per tile.

    `starts` [tiles + 1] are offsets into `entries` [M, 2], which holds, front to back, a Gaussian and the slot of its
    gradient in this tile. Gaussian i owns the slots from `slots[i]` up to `slots[i + 1]`, so that sums over its tiles
    read memory in order.
    """

    starts: np.ndarray
    entries: np.ndarray
    slots: np.ndarray


@inlined
def bin_pointers(bins):
    """The bins with pointers instead of arrays."""
    return Bins(pointer(bins.starts, 0), pointer(bins.entries, 0), pointer(bins.slots, 0))


@inlined
def box_of(boxes, index):
    """Left, top, right and bottom tile of a Gaussian."""
    first = index * 4
    return np.int64(boxes[first]), np.int64(boxes[first + 1]), np.int64(boxes[first + 2]), np.int64(boxes[first + 3])


@kernel
def count_tiles(boxes, tiles_x, starts, slots):
    """Write cumulative counts of Gaussians per tile and of tiles per Gaussian; returns how many are visible."""
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
    """Sort the visible Gaussians by depth, equal depths by index; the low 32 bits of the returned keys are indices.

    The high halves are the bits of the depths relative to the smallest one: a head spans few of them, so that two
    passes suffice.
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
    """One stable pass of the radix sort, by the digit at bit `shift`."""
    positions = np.zeros(DIGITS + 1, np.int64)
    for key in source:
        positions[((((key >> 32) - nearest) >> shift) & (DIGITS - 1)) + 1] += 1
    for digit in range(DIGITS):
        positions[digit + 1] += positions[digit]
    for key in source:
        digit = (((key >> 32) - nearest) >> shift) & (DIGITS - 1)
        target[positions[digit]] = key
        positions[digit] += 1


@kernel
def fill_tiles(order, boxes, tiles_x, bins):
    """Append every Gaussian, front to back, to the lists of its tiles."""
    next_entry = bins.starts[:-1].copy()
    for position in range(order.size):
        if position + PREFETCH_DISTANCE < order.size:
            later = order[position + PREFETCH_DISTANCE] & 0xFFFFFFFF
            prefetch(bins.slots, later)
            prefetch(boxes, later * 4)
        index = order[position] & 0xFFFFFFFF
        left, top, right, bottom = box_of(boxes, index)
        slot = bins.slots[index]
        for y in range(top, bottom):
            for tile in range(y * tiles_x + left, y * tiles_x + right):
                entry = next_entry[tile]
                next_entry[tile] = entry + 1
                bins.entries[2 * entry] = index
                bins.entries[2 * entry + 1] = slot
                slot += 1
