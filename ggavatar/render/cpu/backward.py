"""Gradient of drawing: the tiles once more from front to back, each entry of a tile's list into a slot of its own.

With R what is still to be added to a pixel behind a Gaussian, ∂/∂alpha = light · ⟨g, color⟩ − ⟨g, R⟩ / (1 −
alpha). The inner product with R is one number per pixel that starts at ⟨g, image⟩ and falls, so nothing but the
image is kept from drawing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import (
    lane_sums,
    load,
    load_block_1,
    load_block_3,
    lowest_bit,
    pointer,
    prefetch,
    store,
    store_first_12,
    take_ticket,
)
from ggavatar.jit.simd import fma, negate, select, splat
from ggavatar.render.cpu.binning import bare_bins
from ggavatar.render.cpu.blending import MOST, TILE, TILES_PER_TICKET, block_pixels, coverage, first_light, pass_light
from ggavatar.render.cpu.forward import bare_canvas
from ggavatar.render.cpu.projection import BLUE, DEPTH, GREEN, OPACITY, RECORD, RED, XX, XY, YY, X, Y

SUMS, SUMS_READ = 12, 16
"""Floats of a slot (sums over the pixels of a tile, places below), and how many are read at once."""

SUM_RED, SUM_GREEN, SUM_BLUE, SUM_DEPTH, SUM_WEIGHT, SUM_U, SUM_V, SUM_UU, SUM_UV, SUM_VV = range(10)

PIXELS = 8 * 16
"""Floats per block: light, rest, gradients of red, green, blue and depth, and the coordinates of sixteen pixels."""

BACKWARD_SCRATCH = 16 * PIXELS
AHEAD = 8


class Incoming(NamedTuple):
    """Gradients of the canvas's image [H, W, 3], alpha [H, W] and depth [H, W], flat and padded to whole tiles."""

    image: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray


@kernel
def differentiate_tiles(tickets, scratches, bins, records, view, canvas, incoming, slots):
    """Fill the slots of tiles until none is left."""
    scratch = pointer(scratches, take_ticket(tickets, 1) * BACKWARD_SCRATCH)
    tiles = canvas.ends.size
    bins, records, view, canvas = bare_bins(bins), pointer(records, 0), pointer(view, 0), bare_canvas(canvas)
    incoming = Incoming(pointer(incoming.image, 0), pointer(incoming.alpha, 0), pointer(incoming.depth, 0))
    slots = pointer(slots, 0)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            if bins.starts[tile + 1] > bins.starts[tile]:
                differentiate_tile(scratch, bins, records, view, canvas, incoming, (slots, tile))
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def differentiate_tile(scratch, bins, records, view, canvas, incoming, slots_tile):
    """Fill the slots of one tile."""
    slots, tile = slots_tile
    tiles_x = np.int64(view[25])
    left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
    start, end, stop = np.int64(bins.starts[tile]), np.int64(canvas.ends[tile]), np.int64(bins.starts[tile + 1])
    load_tile(scratch, view, canvas, incoming, left, top)
    for place in range(start, end):
        if place + AHEAD < end:
            prefetch(records, np.int64(bins.entries[2 * (place + AHEAD)]) * RECORD)
        hits = np.int64(canvas.hits[place])
        target = np.int64(bins.entries[2 * place + 1]) * SUMS
        if hits == 0:
            store_first_12(slots, target, splat(np.float32(0)))
            continue
        source = np.int64(bins.entries[2 * place]) * RECORD
        record = pointer(records, source)
        sums = entry_sums(scratch, record, hits, np.float32(left), np.float32(top))
        store_first_12(slots, target, sums)
    for place in range(end, stop):
        store_first_12(slots, np.int64(bins.entries[2 * place + 1]) * SUMS, splat(np.float32(0)))


@inlined
def load_tile(scratch, view, canvas, incoming, left, top):
    """Start every pixel with all light and with the whole of its inner product with the gradient."""
    stride = np.int64(view[25]) * TILE
    width, height = view[23] - np.float32(left), view[24] - np.float32(top)
    for block in range(16):
        place = block * PIXELS
        pixel = (top + (block >> 2) * 4) * stride + left + (block & 3) * 4
        x, y = block_pixels(block)
        red, green, blue = load_block_3(incoming.image, pixel * 3, stride * 3)
        image = load_block_3(canvas.image, pixel * 3, stride * 3)
        alpha, depth = load_block_1(incoming.alpha, pixel, stride)[0], load_block_1(incoming.depth, pixel, stride)[0]
        rest = fma(red, image[0], fma(green, image[1], blue * image[2]))
        rest = fma(depth, load_block_1(canvas.depth, pixel, stride)[0], rest)
        # Alpha is 1 − light, so its gradient acts like a background of −gradient.
        rest = fma(negate(alpha), load_block_1(canvas.light, pixel, stride)[0], rest)
        store(scratch, place, first_light(x, y, width, height))
        store(scratch, place + 16, rest)
        store(scratch, place + 32, red)
        store(scratch, place + 48, green)
        store(scratch, place + 64, blue)
        store(scratch, place + 80, depth)
        store(scratch, place + 96, x)
        store(scratch, place + 112, y)


@inlined
def entry_sums(scratch, record, hits, left, top):
    """The sums of one Gaussian over the blocks it touches in a tile; moves the tile's state behind the Gaussian."""
    offset_x, offset_y = record[X] - left, record[Y] - top
    offset_u, offset_v = -(record[XX] * offset_x + record[XY] * offset_y), -(record[YY] * offset_y)
    zero = splat(np.float32(0))
    reds, greens, blues, depths, weights, us, vs, uus, uvs, vvs = (
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
    )
    while hits != 0:
        place = lowest_bit(hits) * PIXELS
        hits &= hits - 1
        x, y = load(scratch, place + 96), load(scratch, place + 112)
        u = fma(x, record[XX], fma(y, record[XY], splat(offset_u)))
        v = fma(y, record[YY], splat(offset_v))
        power, raw = coverage(u, v, splat(record[OPACITY]))
        alpha, share, going, light, _ = pass_light(power, raw, load(scratch, place))
        red, green, blue = load(scratch, place + 32), load(scratch, place + 48), load(scratch, place + 64)
        depth = load(scratch, place + 80)
        pull = fma(red, record[RED], fma(green, record[GREEN], fma(blue, record[BLUE], depth * record[DEPTH])))
        gain = share * pull
        rest = load(scratch, place + 16) - gain
        store(scratch, place, light)
        store(scratch, place + 16, rest)
        behind = rest / (np.float32(1) - alpha)
        weight = select(going & (raw <= MOST), fma(negate(alpha), behind, gain), np.float32(0))
        reds, greens, blues = fma(share, red, reds), fma(share, green, greens), fma(share, blue, blues)
        depths = fma(share, depth, depths)
        weight_u, weight_v = weight * u, weight * v
        weights, us, vs = weights + weight, us + weight_u, vs + weight_v
        uus, uvs, vvs = fma(weight_u, u, uus), fma(weight_u, v, uvs), fma(weight_v, v, vvs)
    return lane_sums((reds, greens, blues, depths, weights, us, vs, uus, uvs, vvs))
