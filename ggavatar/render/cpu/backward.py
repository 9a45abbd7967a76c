"""Backward pass of blending: each tile again from front to back, each entry of its list into a slot of its own.

Let g be the gradient of a pixel and R the color that the Gaussians behind one add to it; then ∂/∂alpha = transmittance
· ⟨g, color⟩ − ⟨g, R⟩ / (1 − alpha). ⟨g, R⟩ is one number per pixel that starts at ⟨g, image⟩ and decreases, so the
forward pass only has to save the image.
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
from ggavatar.render.cpu.binning import bin_pointers
from ggavatar.render.cpu.blending import (
    ALPHA_LIMIT,
    TILES_PER_TICKET,
    blend,
    block_pixels,
    coverage,
    initial_transmittance,
)
from ggavatar.render.cpu.forward import canvas_pointers
from ggavatar.render.cpu.layout import (
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

SUMS, SUMS_READ = 12, 16
"""Floats of a slot (sums over the pixels of a tile, offsets below), and how many are read at once."""

SUM_RED, SUM_GREEN, SUM_BLUE, SUM_DEPTH, SUM_LOG_ALPHA, SUM_U, SUM_V, SUM_UU, SUM_UV, SUM_VV = range(10)
"""Offsets in a slot: sums of the gradients of color and depth, then of w, w·u, w·v, w·u², w·u·v and w·v².

w is the gradient of the Gaussian's log alpha in a pixel, (u, v) the pixel's whitened offset from the center.
"""

BLOCK_STATE = 8 * 16
"""Floats per block: transmittance, ⟨g, R⟩, gradients of red, green, blue and depth, x and y of sixteen pixels."""

BACKWARD_SCRATCH = 16 * BLOCK_STATE
"""Floats of scratch memory that a worker needs."""

PREFETCH_DISTANCE = 8
"""How many entries ahead records are prefetched."""


class Incoming(NamedTuple):
    """Gradients of the canvas's image [H, W, 3], alpha [H, W] and depth [H, W], flat and padded to whole tiles."""

    image: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray


@kernel
def differentiate_tiles(tickets, scratches, bins, records, view, canvas, incoming, slots):
    """Kernel of one worker: fill the slots of tiles until none is left."""
    scratch = pointer(scratches, take_ticket(tickets, 1) * BACKWARD_SCRATCH)
    tiles = canvas.ends.size
    bins, records, view, canvas = bin_pointers(bins), pointer(records, 0), pointer(view, 0), canvas_pointers(canvas)
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
    tiles_x = np.int64(view[TILES])
    left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
    start, end, stop = np.int64(bins.starts[tile]), np.int64(canvas.ends[tile]), np.int64(bins.starts[tile + 1])
    load_tile(scratch, view, canvas, incoming, left, top)
    for entry in range(start, end):
        if entry + PREFETCH_DISTANCE < end:
            prefetch(records, np.int64(bins.entries[2 * (entry + PREFETCH_DISTANCE)]) * RECORD)
        hits = np.int64(canvas.hits[entry])
        target = np.int64(bins.entries[2 * entry + 1]) * SUMS
        if hits == 0:
            store_first_12(slots, target, splat(np.float32(0)))
            continue
        source = np.int64(bins.entries[2 * entry]) * RECORD
        record = pointer(records, source)
        sums = entry_sums(scratch, record, hits, np.float32(left), np.float32(top))
        store_first_12(slots, target, sums)
    for entry in range(end, stop):
        store_first_12(slots, np.int64(bins.entries[2 * entry + 1]) * SUMS, splat(np.float32(0)))


@inlined
def load_tile(scratch, view, canvas, incoming, left, top):
    """Initialize every pixel's state: initial transmittance, ⟨g, image⟩, gradients and coordinates."""
    stride = np.int64(view[TILES]) * TILE
    width, height = view[SIZE] - np.float32(left), view[SIZE + 1] - np.float32(top)
    for block in range(16):
        offset = block * BLOCK_STATE
        pixel = (top + (block >> 2) * 4) * stride + left + (block & 3) * 4
        x, y = block_pixels(block)
        red, green, blue = load_block_3(incoming.image, pixel * 3, stride * 3)
        image = load_block_3(canvas.image, pixel * 3, stride * 3)
        alpha, depth = load_block_1(incoming.alpha, pixel, stride)[0], load_block_1(incoming.depth, pixel, stride)[0]
        rest = fma(red, image[0], fma(green, image[1], blue * image[2]))
        rest = fma(depth, load_block_1(canvas.depth, pixel, stride)[0], rest)
        # Alpha is 1 − transmittance, so its gradient acts like a background color of −gradient.
        rest = fma(negate(alpha), load_block_1(canvas.transmittance, pixel, stride)[0], rest)
        store(scratch, offset, initial_transmittance(x, y, width, height))
        store(scratch, offset + 16, rest)
        store(scratch, offset + 32, red)
        store(scratch, offset + 48, green)
        store(scratch, offset + 64, blue)
        store(scratch, offset + 80, depth)
        store(scratch, offset + 96, x)
        store(scratch, offset + 112, y)


@inlined
def entry_sums(scratch, record, hits, left, top):
    """The sums of one Gaussian over the blocks it touches in a tile; advances their state past the Gaussian."""
    offset_x, offset_y = record[X] - left, record[Y] - top
    offset_u, offset_v = -(record[WHITEN_XX] * offset_x + record[WHITEN_XY] * offset_y), -(record[WHITEN_YY] * offset_y)
    zero = splat(np.float32(0))
    reds, greens, blues, depths, log_alphas = zero, zero, zero, zero, zero
    us, vs, uus, uvs, vvs = zero, zero, zero, zero, zero
    while hits != 0:
        offset = lowest_bit(hits) * BLOCK_STATE
        hits &= hits - 1
        x, y = load(scratch, offset + 96), load(scratch, offset + 112)
        u = fma(x, record[WHITEN_XX], fma(y, record[WHITEN_XY], splat(offset_u)))
        v = fma(y, record[WHITEN_YY], splat(offset_v))
        power, raw_alpha = coverage(u, v, splat(record[OPACITY]))
        alpha, weight, blended, transmittance, _ = blend(power, raw_alpha, load(scratch, offset))
        red, green, blue = load(scratch, offset + 32), load(scratch, offset + 48), load(scratch, offset + 64)
        depth = load(scratch, offset + 80)
        d_weight = fma(red, record[RED], fma(green, record[GREEN], fma(blue, record[BLUE], depth * record[DEPTH])))
        own = weight * d_weight
        rest = load(scratch, offset + 16) - own
        store(scratch, offset, transmittance)
        store(scratch, offset + 16, rest)
        behind = rest / (np.float32(1) - alpha)
        d_log_alpha = select(blended & (raw_alpha <= ALPHA_LIMIT), fma(negate(alpha), behind, own), np.float32(0))
        reds, greens, blues = fma(weight, red, reds), fma(weight, green, greens), fma(weight, blue, blues)
        depths = fma(weight, depth, depths)
        d_u, d_v = d_log_alpha * u, d_log_alpha * v
        log_alphas, us, vs = log_alphas + d_log_alpha, us + d_u, vs + d_v
        uus, uvs, vvs = fma(d_u, u, uus), fma(d_u, v, uvs), fma(d_v, v, vvs)
    return lane_sums((reds, greens, blues, depths, log_alphas, us, vs, uus, uvs, vvs))
