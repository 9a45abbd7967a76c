"""Discs in Triton: which tiles they touch, the ten nearest of every pixel blended, and the gradient of both.

A tile takes one disc of its list after the other for all of its pixels, front to back. The lists and what happens when
they overflow are those of `ggavatar.render.triton`.
"""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import load_3, store_3
from ggavatar.render.discs import values
from ggavatar.render.triton.gradient import places_of
from ggavatar.render.triton.layout import FAULTS, TILE
from ggavatar.render.triton.projection import covered_tiles, is_finite, report_view_faults
from ggavatar.render.triton.tile_gradient import clear_rest, put
from ggavatar.render.triton.tiles import tile_list, tile_pixels

NEAREST, SHOWN_WEIGHT = tl.constexpr(values.NEAREST), tl.constexpr(values.SHOWN_WEIGHT)
DISC_SUMS = tl.constexpr(5)
"""Sums of a disc over the pixels of a tile: the gradient of its color, and of its center in px."""


@device_kernel
def place_discs(
    means, means2d, depths, radii, colors, pose, intrinsics, background, keys, boxes, counts, status,
    rows, width, height,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Write boxes [N, 4] of tiles left, top, width, height, their counts, and depths to sort by.

    The depths are infinite for discs in no tile. Bits of the status are set for inputs that are not finite.
    """
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    radius = tl.load(radii + row, mask=alive, other=0.0)
    x, y = tl.load(means2d + 2 * row, mask=alive, other=0.0), tl.load(means2d + 2 * row + 1, mask=alive, other=0.0)
    left, across = covered_tiles(x, radius, width, radius > 0)
    top, down = covered_tiles(y, radius, height, radius > 0)
    tl.store(boxes + 4 * row, left, mask=alive)
    tl.store(boxes + 4 * row + 1, top, mask=alive)
    tl.store(boxes + 4 * row + 2, across, mask=alive)
    tl.store(boxes + 4 * row + 3, down, mask=alive)
    tl.store(counts + row, across * down, mask=alive)
    depth = tl.load(depths + row, mask=alive, other=0.0)
    tl.store(keys + row, tl.where(across * down > 0, depth, float("inf")), mask=alive)
    mean, color = load_3(means, row, alive), load_3(colors, row, alive)
    bits = tl.where(is_finite(mean[0]) & is_finite(mean[1]) & is_finite(mean[2]), 0, 1)
    bits |= tl.where(is_finite(color[0]) & is_finite(color[1]) & is_finite(color[2]), 0, 16)
    if tl.max(bits, axis=0) > 0:
        tl.atomic_or(status + FAULTS + tl.zeros_like(bits), bits, mask=alive & (bits > 0), sem="relaxed")
    if tl.program_id(0) == 0:
        report_view_faults(status, pose, intrinsics, background)


@device_function
def _next_disc(entries, order, counts, k, overflowed):
    """Row of the entry `k` of a tile's list, or of the disc of rank `k`, and whether it is in a tile at all."""
    row = tl.load(entries + k, mask=not overflowed, other=0)
    row = tl.where(overflowed, tl.load(order + k, mask=overflowed, other=0).to(tl.int32), row)
    return row, tl.load(counts + row) > 0


@device_function
def _covered(means2d, row, x, y, radius, inside, taken):
    """Alpha of a disc in a tile's pixels, where it is one of the ten nearest, and the offsets in radii."""
    dx, dy = (x - tl.load(means2d + 2 * row)) / radius, (y - tl.load(means2d + 2 * row + 1)) / radius
    square = dx * dx + dy * dy
    touching = inside & (square < 1) & (taken < NEAREST)
    return touching, tl.where(touching, 1 - square, 0.0), dx, dy


@device_kernel
def draw_discs(
    means2d, depths, colors, counts, entries, order, starts, ends, background,
    image, alpha_image, depth_image, light, shown_discs,
    rows, capacity, width, height, tiles_x, radius,
):  # fmt: skip
    """Draw one tile a program; also sets `shown_discs` [N] of those that show, which must be zero before."""
    tile = tl.program_id(0)
    column, line, pixel, in_image = tile_pixels(tile, tiles_x, width, height)
    x, y = column.to(tl.float32) + 0.5, line.to(tl.float32) + 0.5
    k, end, overflowed = tile_list(starts, ends, tile, rows, capacity)
    transmittance, taken = tl.full([TILE * TILE], 1.0, tl.float32), tl.where(in_image, 0, NEAREST)
    red, green = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    blue, depth = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    going = end > k
    while going:
        row, inside = _next_disc(entries, order, counts, k, overflowed)
        touching, alpha, _, _ = _covered(means2d, row, x, y, radius, inside, taken)
        weight = alpha * transmittance
        red += weight * tl.load(colors + 3 * row)
        green += weight * tl.load(colors + 3 * row + 1)
        blue += weight * tl.load(colors + 3 * row + 2)
        depth += weight * tl.load(depths + row)
        shows = touching & ((taken == 0) | (weight > SHOWN_WEIGHT))
        if tl.max(shows.to(tl.int32), axis=0) > 0:
            tl.store(shown_discs + row, 1)
        transmittance *= 1 - alpha
        taken += touching.to(tl.int32)
        k += 1
        going = (k < end) & (tl.min(taken, axis=0) < NEAREST)
    tl.store(image + pixel * 3, red + transmittance * tl.load(background), mask=in_image)
    tl.store(image + pixel * 3 + 1, green + transmittance * tl.load(background + 1), mask=in_image)
    tl.store(image + pixel * 3 + 2, blue + transmittance * tl.load(background + 2), mask=in_image)
    tl.store(alpha_image + pixel, 1 - transmittance, mask=in_image)
    tl.store(depth_image + pixel, depth, mask=in_image)
    tl.store(light + pixel, transmittance, mask=in_image)


@device_kernel
def differentiate_discs(
    means2d, colors, counts, entries, order, places, starts, ends, image, light, to_image, to_alpha, sums,
    rows, capacity, width, height, tiles_x, radius,
    HAS_IMAGE: tl.constexpr, HAS_ALPHA: tl.constexpr,
):  # fmt: skip
    """Write the sums [capacity, DISC_SUMS] of one tile's pairs, given the gradients of image and alpha."""
    tile = tl.program_id(0)
    column, line, pixel, in_image = tile_pixels(tile, tiles_x, width, height)
    x, y = column.to(tl.float32) + 0.5, line.to(tl.float32) + 0.5
    k, end, overflowed = tile_list(starts, ends, tile, rows, capacity)
    red, green = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    blue, rest = tl.zeros([TILE * TILE], tl.float32), tl.zeros([TILE * TILE], tl.float32)
    if HAS_IMAGE:
        red, green, blue = load_3(to_image, pixel, in_image)
        drawn = load_3(image, pixel, in_image)
        rest += red * drawn[0] + green * drawn[1] + blue * drawn[2]
    if HAS_ALPHA:
        # Alpha is 1 − transmittance, so its gradient acts like a background color of −gradient.
        rest -= tl.load(to_alpha + pixel, mask=in_image, other=0.0) * tl.load(light + pixel, mask=in_image, other=0.0)
    transmittance, taken = tl.full([TILE * TILE], 1.0, tl.float32), tl.where(in_image, 0, NEAREST)
    going = end > k
    while going:
        row, inside = _next_disc(entries, order, counts, k, overflowed)
        touching, alpha, dx, dy = _covered(means2d, row, x, y, radius, inside, taken)
        weight = alpha * transmittance
        seen = red * tl.load(colors + 3 * row) + green * tl.load(colors + 3 * row + 1)
        seen += blue * tl.load(colors + 3 * row + 2)
        rest -= weight * seen
        # Where alpha is 1 the pixel is at the disc's center, and what moves the center changes nothing.
        to_cover = transmittance * seen - rest / tl.maximum(1 - alpha, 1e-10)
        to_offset = tl.where(touching, 2 * to_cover / radius, 0.0)
        place = tl.where(overflowed, k, tl.load(places + k, mask=not overflowed, other=0).to(tl.int32))
        into = sums + place.to(tl.int64) * DISC_SUMS
        put(into, tl.sum(weight * red, axis=0), inside, overflowed)
        put(into + 1, tl.sum(weight * green, axis=0), inside, overflowed)
        put(into + 2, tl.sum(weight * blue, axis=0), inside, overflowed)
        put(into + 3, tl.sum(to_offset * dx, axis=0), inside, overflowed)
        put(into + 4, tl.sum(to_offset * dy, axis=0), inside, overflowed)
        transmittance *= 1 - alpha
        taken += touching.to(tl.int32)
        k += 1
        going = (k < end) & (tl.min(taken, axis=0) < NEAREST)
    if not overflowed:
        clear_rest(sums, places, k, end, DISC_SUMS)


@device_kernel
def gather_discs(
    order, ends, counts, sums, to_colors, to_means2d, rows, capacity, BLOCK: tl.constexpr
):  # fmt: skip
    """Write the gradients of colors [N, 3] and centers [N, 2]: sums over the tiles, in their order."""
    rank = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = rank < rows
    row = tl.load(order + rank, mask=alive, other=0).to(tl.int32)
    first, count = places_of(ends, counts, rank, row, alive, rows, capacity)
    zero = tl.zeros([BLOCK], tl.float32)
    red, green, blue, x, y = zero, zero, zero, zero, zero
    for number in range(tl.max(count, axis=0)):
        there = number < count
        at = sums + (first + number).to(tl.int64) * DISC_SUMS
        red += tl.load(at, mask=there, other=0.0)
        green += tl.load(at + 1, mask=there, other=0.0)
        blue += tl.load(at + 2, mask=there, other=0.0)
        x += tl.load(at + 3, mask=there, other=0.0)
        y += tl.load(at + 4, mask=there, other=0.0)
    store_3(to_colors, row, alive, (red, green, blue))
    tl.store(to_means2d + 2 * row, x, mask=alive)
    tl.store(to_means2d + 2 * row + 1, y, mask=alive)
