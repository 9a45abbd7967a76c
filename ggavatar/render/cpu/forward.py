"""Forward pass of blending: per tile, 64 Gaussians at a time, block by block, so that a block stays in registers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import (
    column_bits,
    load,
    lowest_bit,
    pointer,
    prefetch,
    store,
    store_block_1,
    store_block_3,
    take_ticket,
)
from ggavatar.jit.simd import absolute, bits_of, fma, splat
from ggavatar.render.cpu.binning import bin_pointers
from ggavatar.render.cpu.blending import (
    TILES_PER_TICKET,
    blend,
    block_pixels,
    coverage,
    initial_transmittance,
    touched_blocks,
)
from ggavatar.render.cpu.layout import (
    BACKGROUND,
    BLUE,
    DEPTH,
    GREEN,
    OPACITY,
    RECORD,
    RED,
    SIZE,
    TILE,
    TILES,
    WHITEN_XX,
    WHITEN_XY,
    WHITEN_YY,
    X,
    Y,
)

BATCH = 64
"""Gaussians that are blended into all blocks of a tile before the next ones are loaded."""

STATE = 5 * 16
"""Floats per block: transmittance, red, green, blue and depth of sixteen pixels."""

FORWARD_SCRATCH = 16 * STATE + BATCH * RECORD
"""Floats of scratch memory that a worker needs: the state of sixteen blocks, then the records of a batch."""

PREFETCH_DISTANCE = 16
"""How many entries ahead records are prefetched."""

ONE = np.uint16(1)


class Canvas(NamedTuple):
    """The output of the forward pass, height and width padded to whole tiles.

    `image` [H, W, 3], the final `transmittance` [H, W], `depth` [H, W] and `alpha` [H, W]; `hits` [M] are the blocks
    into which each entry of the tile lists was blended, `ends` [tiles] the entries at which tiles were finished.
    """

    image: np.ndarray
    transmittance: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    hits: np.ndarray
    ends: np.ndarray


@kernel
def draw_tiles(tickets, scratches, masks, bins, records, view, canvas):
    """Kernel of one worker: draw tiles until none is left."""
    worker = take_ticket(tickets, 1)
    work = pointer(scratches, worker * FORWARD_SCRATCH), pointer(masks, worker * BATCH)
    tiles = canvas.ends.size
    bins, records, view, canvas = bin_pointers(bins), pointer(records, 0), pointer(view, 0), canvas_pointers(canvas)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            draw_tile(work, bins, records, view, canvas, tile)
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def canvas_pointers(canvas):
    """The canvas with pointers instead of arrays."""
    image, transmittance, depth = pointer(canvas.image, 0), pointer(canvas.transmittance, 0), pointer(canvas.depth, 0)
    alpha = pointer(canvas.alpha, 0)
    return Canvas(image, transmittance, depth, alpha, pointer(canvas.hits, 0), pointer(canvas.ends, 0))


@inlined
def draw_tile(work, bins, records, view, canvas, tile):
    """Draw one tile."""
    scratch, mask = work
    tiles_x = np.int64(view[TILES])
    left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
    unfinished = clear_tile(scratch, view[SIZE] - np.float32(left), view[SIZE + 1] - np.float32(top))
    entry, end = np.int64(bins.starts[tile]), np.int64(bins.starts[tile + 1])
    while entry < end and unfinished != 0:
        size: Any = min(BATCH, end - entry)
        corner = np.float32(left), np.float32(top)
        gather_batch(work, pointer(bins.entries, 2 * entry), size, records, corner, unfinished)
        for block in range(16):
            if (unfinished >> block) & 1:
                unfinished &= ~(draw_block(scratch, mask, block) << block)
        for number in range(size):
            canvas.hits[entry + number] = mask[number]
        entry += size
    canvas.ends[tile] = entry
    write_tile(scratch, view, canvas, left, top)


@inlined
def clear_tile(scratch, width, height):
    """Initialize every pixel's state; returns the bits of the blocks with a pixel inside the image."""
    unfinished = np.int64(0)
    for block in range(16):
        x, y = block_pixels(block)
        transmittance = initial_transmittance(x, y, width, height)
        store(scratch, block * STATE, transmittance)
        for channel in range(1, 5):
            store(scratch, block * STATE + channel * 16, splat(np.float32(0)))
        if bits_of(transmittance > np.float32(0)) != 0:
            unfinished |= 1 << block
    return unfinished


@inlined
def gather_batch(work, entries, size, records, corner, unfinished):
    """Copy up to 64 records, centers whitened and relative to the tile's corner, and note which blocks they touch."""
    scratch, mask = work
    for number in range(BATCH):
        if number >= size:
            mask[number] = 0
            continue
        if number + PREFETCH_DISTANCE < size:
            prefetch(records, np.int64(entries[2 * (number + PREFETCH_DISTANCE)]) * RECORD)
        source, target = np.int64(entries[2 * number]) * RECORD, 16 * STATE + number * RECORD
        store(scratch, target, load(records, source))
        record = pointer(records, source)
        x, y = record[X] - corner[0], record[Y] - corner[1]
        mask[number] = np.uint16(touched_blocks(record, x, y) & unfinished)
        scratch[target + X] = -(record[WHITEN_XX] * x + record[WHITEN_XY] * y)
        scratch[target + Y] = -(record[WHITEN_YY] * y)


@inlined
def draw_block(scratch, mask, block):
    """Blend the batch into one block, front to back; returns 1 if all its pixels are finished, else 0."""
    offset = block * STATE
    x, y = block_pixels(block)
    transmittance, red, green = load(scratch, offset), load(scratch, offset + 16), load(scratch, offset + 32)
    blue, depth = load(scratch, offset + 48), load(scratch, offset + 64)
    bits, finished = column_bits(mask, block), 0
    while bits != 0:
        record = 16 * STATE + lowest_bit(bits) * RECORD
        bits &= bits - 1
        u = fma(x, scratch[record + WHITEN_XX], fma(y, scratch[record + WHITEN_XY], splat(scratch[record + X])))
        v = fma(y, scratch[record + WHITEN_YY], splat(scratch[record + Y]))
        power, raw_alpha = coverage(u, v, splat(scratch[record + OPACITY]))
        _, weight, _, transmittance, finished_pixels = blend(power, raw_alpha, transmittance)
        red = fma(weight, scratch[record + RED], red)
        green = fma(weight, scratch[record + GREEN], green)
        blue = fma(weight, scratch[record + BLUE], blue)
        depth = fma(weight, scratch[record + DEPTH], depth)
        if finished_pixels != 0 and bits_of(transmittance > np.float32(0)) == 0:
            finished = 1
            break
    while bits != 0:  # the backward pass can skip what is occluded in this block
        mask[lowest_bit(bits)] &= ~(ONE << np.uint16(block))
        bits &= bits - 1
    store(scratch, offset, transmittance)
    store(scratch, offset + 16, red)
    store(scratch, offset + 32, green)
    store(scratch, offset + 48, blue)
    store(scratch, offset + 64, depth)
    return finished


@inlined
def write_tile(scratch, view, canvas, left, top):
    """Composite the tile on the background and write it to the canvas."""
    stride = np.int64(view[TILES]) * TILE
    for block in range(16):
        offset = block * STATE
        pixel = (top + (block >> 2) * 4) * stride + left + (block & 3) * 4
        transmittance = absolute(load(scratch, offset))
        red = fma(transmittance, view[BACKGROUND], load(scratch, offset + 16))
        green = fma(transmittance, view[BACKGROUND + 1], load(scratch, offset + 32))
        blue = fma(transmittance, view[BACKGROUND + 2], load(scratch, offset + 48))
        store_block_3(canvas.image, pixel * 3, stride * 3, (red, green, blue))
        store_block_1(canvas.transmittance, pixel, stride, (transmittance,))
        store_block_1(canvas.alpha, pixel, stride, (np.float32(1) - transmittance,))
        store_block_1(canvas.depth, pixel, stride, (load(scratch, offset + 64),))
