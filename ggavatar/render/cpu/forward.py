"""Drawing: tile by tile, 64 Gaussians at a time, block by block, so that a block stays in registers."""

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
from ggavatar.render.cpu.binning import bare_bins
from ggavatar.render.cpu.blending import (
    TILE,
    TILES_PER_TICKET,
    block_pixels,
    coverage,
    first_light,
    pass_light,
    touched_blocks,
)
from ggavatar.render.cpu.projection import BLUE, DEPTH, GREEN, OPACITY, RECORD, RED, XX, XY, YY, X, Y

BATCH = 64
STATE = 5 * 16
"""Floats per block: light, red, green, blue and depth of sixteen pixels."""

FORWARD_SCRATCH = 16 * STATE + BATCH * RECORD
"""Floats a worker needs: the state of sixteen blocks, then the records of a batch."""

AHEAD = 16
ALL_BLOCKS = (1 << 16) - 1
ONE = np.uint16(1)


class Canvas(NamedTuple):
    """What is drawn, height and width padded to whole tiles.

    `image` [H, W, 3], `light` [H, W] the transmittance that is left, `depth` [H, W], `alpha` [H, W]; `hits` [M]
    the blocks each entry of the tile lists was drawn in; `ends` [tiles] where drawing stopped in the tile
    lists.
    """

    image: np.ndarray
    light: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    hits: np.ndarray
    ends: np.ndarray


@kernel
def draw_tiles(tickets, scratches, masks, bins, records, view, canvas):
    """Draw tiles until none is left."""
    worker = take_ticket(tickets, 1)
    work = pointer(scratches, worker * FORWARD_SCRATCH), pointer(masks, worker * BATCH)
    tiles = canvas.ends.size
    bins, records, view, canvas = bare_bins(bins), pointer(records, 0), pointer(view, 0), bare_canvas(canvas)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            draw_tile(work, bins, records, view, canvas, tile)
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def bare_canvas(canvas):
    """The canvas with pointers instead of arrays."""
    image, light, depth = pointer(canvas.image, 0), pointer(canvas.light, 0), pointer(canvas.depth, 0)
    alpha = pointer(canvas.alpha, 0)
    return Canvas(image, light, depth, alpha, pointer(canvas.hits, 0), pointer(canvas.ends, 0))


@inlined
def draw_tile(work, bins, records, view, canvas, tile):
    """Draw one tile."""
    scratch, mask = work
    tiles_x = np.int64(view[25])
    left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
    alive = clear_tile(scratch, view[23] - np.float32(left), view[24] - np.float32(top))
    place, end = np.int64(bins.starts[tile]), np.int64(bins.starts[tile + 1])
    while place < end and alive != 0:
        size: Any = min(BATCH, end - place)
        gather_batch(work, pointer(bins.entries, 2 * place), size, records, (np.float32(left), np.float32(top)), alive)
        for block in range(16):
            if (alive >> block) & 1:
                alive &= ~(draw_block(scratch, mask, block) << block)
        for number in range(size):
            canvas.hits[place + number] = mask[number]
        place += size
    canvas.ends[tile] = place
    write_tile(scratch, view, canvas, left, top)


@inlined
def clear_tile(scratch, width, height):
    """Start every pixel with no color and all light; returns the bits of the blocks with a pixel in the image."""
    alive = np.int64(0)
    for block in range(16):
        x, y = block_pixels(block)
        light = first_light(x, y, width, height)
        store(scratch, block * STATE, light)
        for channel in range(1, 5):
            store(scratch, block * STATE + channel * 16, splat(np.float32(0)))
        if bits_of(light > np.float32(0)) != 0:
            alive |= 1 << block
    return alive


@inlined
def gather_batch(work, entries, size, records, corner, alive):
    """Copy up to 64 records, their centers whitened and seen from the tile's corner, and note the blocks they touch."""
    scratch, mask = work
    for number in range(BATCH):
        if number >= size:
            mask[number] = 0
            continue
        if number + AHEAD < size:
            prefetch(records, np.int64(entries[2 * (number + AHEAD)]) * RECORD)
        source, target = np.int64(entries[2 * number]) * RECORD, 16 * STATE + number * RECORD
        store(scratch, target, load(records, source))
        record = pointer(records, source)
        x, y = record[X] - corner[0], record[Y] - corner[1]
        mask[number] = np.uint16(touched_blocks(record, x, y) & alive)
        scratch[target + X] = -(record[XX] * x + record[XY] * y)
        scratch[target + Y] = -(record[YY] * y)


@inlined
def draw_block(scratch, mask, block):
    """Blend the batch into one block, front to back; returns 1 if all its pixels are finished, else 0."""
    place = block * STATE
    x, y = block_pixels(block)
    light, red, green = load(scratch, place), load(scratch, place + 16), load(scratch, place + 32)
    blue, depth = load(scratch, place + 48), load(scratch, place + 64)
    bits, finished = column_bits(mask, block), 0
    while bits != 0:
        record = 16 * STATE + lowest_bit(bits) * RECORD
        bits &= bits - 1
        u = fma(x, scratch[record + XX], fma(y, scratch[record + XY], splat(scratch[record + X])))
        v = fma(y, scratch[record + YY], splat(scratch[record + Y]))
        power, raw = coverage(u, v, splat(scratch[record + OPACITY]))
        _, share, _, light, ended = pass_light(power, raw, light)
        red = fma(share, scratch[record + RED], red)
        green = fma(share, scratch[record + GREEN], green)
        blue = fma(share, scratch[record + BLUE], blue)
        depth = fma(share, scratch[record + DEPTH], depth)
        if ended != 0 and bits_of(light > np.float32(0)) == 0:
            finished = 1
            break
    while bits != 0:  # the gradient need not look at what is hidden here
        mask[lowest_bit(bits)] &= ~(ONE << np.uint16(block))
        bits &= bits - 1
    store(scratch, place, light)
    store(scratch, place + 16, red)
    store(scratch, place + 32, green)
    store(scratch, place + 48, blue)
    store(scratch, place + 64, depth)
    return finished


@inlined
def write_tile(scratch, view, canvas, left, top):
    """Put the tile on the background and into the canvas."""
    stride = np.int64(view[25]) * TILE
    for block in range(16):
        place = block * STATE
        pixel = (top + (block >> 2) * 4) * stride + left + (block & 3) * 4
        light = absolute(load(scratch, place))
        red = fma(light, view[27], load(scratch, place + 16))
        green = fma(light, view[28], load(scratch, place + 32))
        blue = fma(light, view[29], load(scratch, place + 48))
        store_block_3(canvas.image, pixel * 3, stride * 3, (red, green, blue))
        store_block_1(canvas.light, pixel, stride, (light,))
        store_block_1(canvas.alpha, pixel, stride, (np.float32(1) - light,))
        store_block_1(canvas.depth, pixel, stride, (load(scratch, place + 64),))
