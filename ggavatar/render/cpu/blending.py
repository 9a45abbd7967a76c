"""What drawing and its gradient share: the geometry of a tile, and the coverage of sixteen pixels by one Gaussian.

A tile is 16 × 16 pixels in sixteen blocks of 4 × 4; a block is one vector. Both passes evaluate the very same
operations in the same order, so they agree about every pixel that is skipped or finished.
"""

from __future__ import annotations

import math

import numpy as np

from ggavatar.jit.kernels import inlined
from ggavatar.jit.simd import absolute, bits_of, exp2, floor, fma, maximum, minimum, negate, ramp, select
from ggavatar.render.constants import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE

TILE = 16
"""Pixels along a side of a tile."""

TILES_PER_TICKET = 4

BLOCK = 4
LOG2_MIN_ALPHA = np.float32(math.log2(MIN_ALPHA))
MOST = np.float32(MAX_ALPHA)
LEAST_LIGHT = np.float32(MIN_TRANSMITTANCE)


@inlined
def lane_grid():
    """Column and row, 0 to 3, of every lane in a 4 × 4 square."""
    number = ramp()
    row = floor(number * np.float32(0.25))
    return fma(row, np.float32(-4), number), row


@inlined
def block_pixels(block):
    """Pixel centers of a block, px from the corner of the tile."""
    x, y = lane_grid()
    return x + np.float32((block & 3) * BLOCK + 0.5), y + np.float32((block >> 2) * BLOCK + 0.5)


@inlined
def first_light(pixel_x, pixel_y, width, height):
    """Transmittance before anything is drawn: 1 in the image, −1 (finished, as the sign says) outside of it."""
    inside = (pixel_x < width) & (pixel_y < height)
    return select(inside, np.float32(1), np.float32(-1))


@inlined
def touched_blocks(record, x, y):
    """Bits of the blocks that the ellipse alpha ≥ 1/255 meets; `x`, `y` is its center from the corner of the tile, px.

    The nearest point of a rectangle of pixel centers lies on one of the two sides that face the center, and on
    a side it is found in closed form. So the test is exact, apart from a little slack.
    """
    column, row = lane_grid()
    left, top = column * np.float32(BLOCK) + (np.float32(0.5) - x), row * np.float32(BLOCK) + (np.float32(0.5) - y)
    right, bottom = left + np.float32(BLOCK - 1), top + np.float32(BLOCK - 1)
    side_x, side_y = maximum(left, minimum(right, np.float32(0))), maximum(top, minimum(bottom, np.float32(0)))
    free_y = maximum(top, minimum(bottom, side_x * record[10]))
    free_x = maximum(left, minimum(right, side_y * record[11]))
    nearest = minimum(spread(record, side_x, free_y), spread(record, free_x, side_y))
    return bits_of(nearest <= record[12])


@inlined
def spread(record, dx, dy):
    """u² + v² at an offset from the center: half the squared distance in standard deviations, in units of ln 2."""
    u = fma(dx, record[0], dy * record[1])
    v = dy * record[2]
    return fma(u, u, v * v)


@inlined
def coverage(u, v, opacity):
    """log2 of alpha before its limits, and 2 to that, which can be anything far outside of the ellipse, NaN too."""
    power = fma(negate(u), u, fma(negate(v), v, opacity))
    return power, exp2(power)


@inlined
def pass_light(power, raw, light):
    """One Gaussian in front of sixteen pixels.

    Args:
        power: log2 of alpha before its limits.
        raw: Alpha before its limits.
        light: Transmittance before; negative where the pixel is finished.

    Returns:
        Alpha; its share of the light, 0 where it is not blended; where it is blended; the transmittance
        after; the bits of pixels that are finished.
    """
    alpha = minimum(raw, MOST)
    inside = power >= LOG2_MIN_ALPHA
    share = alpha * light
    after = light - share
    going = inside & (after >= LEAST_LIGHT)
    ended = inside & (after < LEAST_LIGHT)
    remaining = select(going, after, select(ended, negate(absolute(light)), light))
    return alpha, select(going, share, np.float32(0)), going, remaining, bits_of(ended)
