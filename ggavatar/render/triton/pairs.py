"""Lists of the Gaussians that touch each tile: kernels around a stable sort by tile of pairs that are sorted by depth.

The number of pairs is known on the device only. Their memory has a fixed capacity, and what does not fit is not listed;
then the tiles walk through all Gaussians instead (`ggavatar.render.triton.tiles`).
"""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.render.triton.layout import PAIRS


@device_kernel
def list_pairs(
    order, ends, boxes, pair_tiles, pair_rows, status,
    rows, tiles_x, tiles, capacity, steps,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the tile and the Gaussian of every pair, Gaussians front to back; places after the last pair get `tiles`.

    Reads the order by depth [N], and in that order the cumulated counts `ends` [N]; boxes [N, 4] are in order of rows.
    `steps` is the number of steps of a binary search in N. Also writes the number of pairs to the status.
    """
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = place < capacity
    total = tl.load(ends + rows - 1)
    rank = _first_above(ends, place, rows, steps, inside)
    listed = inside & (place < total)
    row = tl.load(order + rank, mask=listed, other=0)
    left, top = tl.load(boxes + 4 * row, mask=listed, other=0), tl.load(boxes + 4 * row + 1, mask=listed, other=0)
    across = tl.maximum(tl.load(boxes + 4 * row + 2, mask=listed, other=1), 1)
    before = tl.load(ends + rank - 1, mask=listed & (rank > 0), other=0)
    within = (place - before).to(tl.int32)
    tile = (top + within // across) * tiles_x + left + within % across
    tl.store(pair_tiles + place, tl.where(listed, tile, tiles), mask=inside)
    tl.store(pair_rows + place, row.to(tl.int32), mask=inside)
    if tl.program_id(0) == 0:
        tl.store(status + PAIRS, tl.minimum(total, 2147483647).to(tl.int32))


@device_kernel
def finish_lists(
    sorted_tiles, places, pair_rows, entries, starts,
    capacity, tiles, steps,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the Gaussian of every pair in order of tiles [capacity], and where each tile's list starts [tiles + 1]."""
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = place < capacity
    source = tl.load(places + place, mask=inside, other=0)
    tl.store(entries + place, tl.load(pair_rows + source, mask=inside, other=0), mask=inside)
    if tl.program_id(0) * BLOCK <= tiles:
        tl.store(
            starts + place, _first_above(sorted_tiles, place - 1, capacity, steps, place <= tiles), mask=place <= tiles
        )


@device_function
def _first_above(ascending, value, length, steps, mask):
    """Index of the first element that exceeds `value`; `length` if none does."""
    low, high = tl.zeros(value.shape, tl.int32), tl.zeros(value.shape, tl.int32) + length
    for _ in range(steps):
        middle = (low + high) // 2
        open_ = mask & (low < high)
        above = tl.load(ascending + middle, mask=open_, other=0) > value
        high = tl.where(open_ & above, middle, high)
        low = tl.where(open_ & ~above, middle + 1, low)
    return low
