"""The forward kernel of tiles: Gaussians of a tile's list blended front to back in its 256 pixels."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_kernel
from ggavatar.render.triton.layout import BLUE, CHUNK, DEPTH, GREEN, RED, TILE
from ggavatar.render.triton.tiles import alphas_at, blended, listed_rows, record_of, tile_list, tile_pixels


@device_kernel
def draw_tiles(
    records, entries, order, starts, ends, background,
    image, alpha_image, depth_image, light,
    rows, capacity, width, height, tiles_x,
):  # fmt: skip
    """Draw one tile a program: image [H, W, 3] on the background, alpha, depth and final transmittance [H, W]."""
    tile = tl.program_id(0)
    column, line, pixel, shown = tile_pixels(tile, tiles_x, width, height)
    x, y = column.to(tl.float32) + 0.5, line.to(tl.float32) + 0.5
    first, end, overflowed = tile_list(starts, ends, tile, rows, capacity)
    transmittance = tl.full([TILE * TILE], 1.0, tl.float32)
    alive = tl.where(shown, 1, 0)
    red, green = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    blue, depth = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    going = end > first
    while going:
        k = first + tl.arange(0, CHUNK)
        there = k < end
        at = record_of(records, listed_rows(entries, order, k, there, overflowed))
        _, _, _, alpha = alphas_at(at, there, x, y)
        _, weight, transmittance, alive = blended(alpha, transmittance, alive)
        red += tl.sum(weight * tl.load(at + RED, mask=there, other=0.0)[None, :], axis=1)
        green += tl.sum(weight * tl.load(at + GREEN, mask=there, other=0.0)[None, :], axis=1)
        blue += tl.sum(weight * tl.load(at + BLUE, mask=there, other=0.0)[None, :], axis=1)
        depth += tl.sum(weight * tl.load(at + DEPTH, mask=there, other=0.0)[None, :], axis=1)
        first += CHUNK
        going = (first < end) & (tl.max(alive, axis=0) > 0)
    tl.store(image + pixel * 3, red + transmittance * tl.load(background), mask=shown)
    tl.store(image + pixel * 3 + 1, green + transmittance * tl.load(background + 1), mask=shown)
    tl.store(image + pixel * 3 + 2, blue + transmittance * tl.load(background + 2), mask=shown)
    tl.store(alpha_image + pixel, 1 - transmittance, mask=shown)
    tl.store(depth_image + pixel, depth, mask=shown)
    tl.store(light + pixel, transmittance, mask=shown)
