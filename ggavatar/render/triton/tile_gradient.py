"""The backward kernel of tiles: front to back again, ten sums over the tile's pixels for every Gaussian of its list.

Every pair of Gaussian and tile has a place of its own for its sums, in the order in which pairs were listed, so that
nothing is added atomically and results do not depend on which program is first.
"""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.render.triton.layout import (
    BLUE,
    CHUNK,
    DEPTH,
    GREEN,
    MAX_ALPHA,
    RED,
    SUMS,
    TILE,
    TO_BLUE,
    TO_DEPTH,
    TO_GREEN,
    TO_LOG_ALPHA,
    TO_RED,
    TO_U,
    TO_UU,
    TO_UV,
    TO_V,
    TO_VV,
)
from ggavatar.render.triton.tiles import alphas_at, blended, listed_rows, record_of, tile_list, tile_pixels


@device_kernel
def differentiate_tiles(
    records, entries, order, places, starts, ends,
    image, depth_image, light, to_image, to_alpha, to_depth, sums,
    rows, capacity, width, height, tiles_x,
    HAS_IMAGE: tl.constexpr, HAS_ALPHA: tl.constexpr, HAS_DEPTH: tl.constexpr,
):  # fmt: skip
    """Write the sums [capacity, SUMS] of one tile's pairs, given the gradients of image, alpha and depth.

    `places` [capacity] are those of the sorted pairs before sorting. If the pairs overflowed, sums are added to place
    `rank` of every Gaussian instead, whose memory must be zero.
    """
    tile = tl.program_id(0)
    column, line, pixel, shown = tile_pixels(tile, tiles_x, width, height)
    x, y = column.to(tl.float32) + 0.5, line.to(tl.float32) + 0.5
    first, end, overflowed = tile_list(starts, ends, tile, rows, capacity)
    red, green = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    blue, depth = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    rest = tl.zeros([TILE * TILE], tl.float32)
    if HAS_IMAGE:
        red = tl.load(to_image + pixel * 3, mask=shown, other=0.0)
        green = tl.load(to_image + pixel * 3 + 1, mask=shown, other=0.0)
        blue = tl.load(to_image + pixel * 3 + 2, mask=shown, other=0.0)
        rest += red * tl.load(image + pixel * 3, mask=shown, other=0.0)
        rest += green * tl.load(image + pixel * 3 + 1, mask=shown, other=0.0)
        rest += blue * tl.load(image + pixel * 3 + 2, mask=shown, other=0.0)
    if HAS_DEPTH:
        depth = tl.load(to_depth + pixel, mask=shown, other=0.0)
        rest += depth * tl.load(depth_image + pixel, mask=shown, other=0.0)
    if HAS_ALPHA:
        # Alpha is 1 − transmittance, so its gradient acts like a background color of −gradient.
        rest -= tl.load(to_alpha + pixel, mask=shown, other=0.0) * tl.load(light + pixel, mask=shown, other=0.0)
    transmittance = tl.full([TILE * TILE], 1.0, tl.float32)
    alive = tl.where(shown, 1, 0)
    going = end > first
    while going:
        k = first + tl.arange(0, CHUNK)
        there = k < end
        at = record_of(records, listed_rows(entries, order, k, there, overflowed))
        u, v, raw, alpha = alphas_at(at, there, x, y)
        alpha, weight, transmittance, alive = blended(alpha, transmittance, alive)
        seen = red[:, None] * tl.load(at + RED, mask=there, other=0.0)[None, :]
        seen += green[:, None] * tl.load(at + GREEN, mask=there, other=0.0)[None, :]
        seen += blue[:, None] * tl.load(at + BLUE, mask=there, other=0.0)[None, :]
        if HAS_DEPTH:
            seen += depth[:, None] * tl.load(at + DEPTH, mask=there, other=0.0)[None, :]
        own = weight * seen
        behind = (rest[:, None] - tl.cumsum(own, axis=1)) / (1 - alpha)
        to_log_alpha = tl.where(raw <= MAX_ALPHA, own - alpha * behind, 0.0)
        rest -= tl.sum(own, axis=1)
        place = tl.where(overflowed, k, tl.load(places + k, mask=there & (not overflowed), other=0).to(tl.int32))
        into = sums + place.to(tl.int64) * SUMS
        put(into + TO_RED, tl.sum(weight * red[:, None], axis=0), there, overflowed)
        put(into + TO_GREEN, tl.sum(weight * green[:, None], axis=0), there, overflowed)
        put(into + TO_BLUE, tl.sum(weight * blue[:, None], axis=0), there, overflowed)
        put(into + TO_DEPTH, tl.sum(weight * depth[:, None], axis=0), there, overflowed)
        _put_shape(into, to_log_alpha, u, v, there, overflowed)
        first += CHUNK
        going = (first < end) & (tl.max(alive, axis=0) > 0)
    if not overflowed:
        clear_rest(sums, places, first, end, SUMS)


@device_function
def put(target, value, there, overflowed):
    """Write to a pair's own place, or add to a place that several tiles share."""
    if overflowed:
        tl.atomic_add(target, value, mask=there, sem="relaxed")
    else:
        tl.store(target, value, mask=there)


@device_function
def _put_shape(into, to_log_alpha, u, v, there, overflowed):
    """Write, or add, the sums that opacity, center and covariance depend on."""
    to_u, to_v = to_log_alpha * u, to_log_alpha * v
    put(into + TO_LOG_ALPHA, tl.sum(to_log_alpha, axis=0), there, overflowed)
    put(into + TO_U, tl.sum(to_u, axis=0), there, overflowed)
    put(into + TO_V, tl.sum(to_v, axis=0), there, overflowed)
    put(into + TO_UU, tl.sum(to_u * u, axis=0), there, overflowed)
    put(into + TO_UV, tl.sum(to_u * v, axis=0), there, overflowed)
    put(into + TO_VV, tl.sum(to_v * v, axis=0), there, overflowed)


@device_function
def clear_rest(sums, places, first, end, COUNT: tl.constexpr):
    """Write zeros for the pairs behind the last one that a pixel shows."""
    while first < end:
        k = first + tl.arange(0, TILE * TILE)
        there = k < end
        into = sums + tl.load(places + k, mask=there, other=0) * COUNT
        for number in tl.static_range(COUNT):
            tl.store(into + number, tl.zeros([TILE * TILE], tl.float32), mask=there)
        first += TILE * TILE
