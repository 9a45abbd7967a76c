"""What the forward and the backward pass share: the geometry of a tile, and blending of one Gaussian into a block.

A tile is 16 × 16 pixels in sixteen blocks of 4 × 4; a block is one vector. Both passes evaluate the same operations in
the same order, so they agree on every pixel that is skipped or finished.
"""

from __future__ import annotations

import math

import numpy as np

from ggavatar.jit.kernels import inlined
from ggavatar.jit.simd import absolute, bits_of, exp2, floor, fma, lane_indices, maximum, minimum, negate, select
from ggavatar.render.constants import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE
from ggavatar.render.cpu.layout import REACH, STEP_X, STEP_Y, WHITEN_XX, WHITEN_XY, WHITEN_YY

TILES_PER_TICKET = 4
"""Tiles that a thread takes at once."""

BLOCK = 4
"""Pixels along a side of a block."""

LOG2_MIN_ALPHA = np.float32(math.log2(MIN_ALPHA))
ALPHA_LIMIT = np.float32(MAX_ALPHA)
TRANSMITTANCE_LIMIT = np.float32(MIN_TRANSMITTANCE)


@inlined
def lane_grid():
    """Column and row, 0 to 3, of every lane in a block of 4 × 4."""
    number = lane_indices()
    row = floor(number * np.float32(0.25))
    return fma(row, np.float32(-4), number), row


@inlined
def block_pixels(block):
    """Pixel centers of a block, px from the corner of the tile."""
    x, y = lane_grid()
    return x + np.float32((block & 3) * BLOCK + 0.5), y + np.float32((block >> 2) * BLOCK + 0.5)


@inlined
def initial_transmittance(pixel_x, pixel_y, width, height):
    """Transmittance before the first Gaussian: 1 inside the image, −1 (the sign marks a finished pixel) outside."""
    inside = (pixel_x < width) & (pixel_y < height)
    return select(inside, np.float32(1), np.float32(-1))


@inlined
def touched_blocks(record, x, y):
    """Bits of the blocks that the ellipse alpha ≥ 1/255 meets; `x`, `y` is its center from the corner of the tile, px.

    The point of a rectangle of pixel centers that is nearest in the ellipse's metric lies on one of the two sides that
    face the center, where it has a closed form. The test is therefore exact up to the slack in `REACH`.
    """
    column, row = lane_grid()
    left, top = column * np.float32(BLOCK) + (np.float32(0.5) - x), row * np.float32(BLOCK) + (np.float32(0.5) - y)
    right, bottom = left + np.float32(BLOCK - 1), top + np.float32(BLOCK - 1)
    side_x, side_y = maximum(left, minimum(right, np.float32(0))), maximum(top, minimum(bottom, np.float32(0)))
    free_y = maximum(top, minimum(bottom, side_x * record[STEP_Y]))
    free_x = maximum(left, minimum(right, side_y * record[STEP_X]))
    nearest = minimum(square_distance(record, side_x, free_y), square_distance(record, free_x, side_y))
    return bits_of(nearest <= record[REACH])


@inlined
def square_distance(record, dx, dy):
    """u² + v² at an offset from the center: half the squared Mahalanobis distance, in units of ln 2."""
    u = fma(dx, record[WHITEN_XX], dy * record[WHITEN_XY])
    v = dy * record[WHITEN_YY]
    return fma(u, u, v * v)


@inlined
def coverage(u, v, opacity):
    """log2 of alpha and alpha, both unclamped; alpha can be anything far outside the ellipse, even NaN."""
    power = fma(negate(u), u, fma(negate(v), v, opacity))
    return power, exp2(power)


@inlined
def blend(power, raw_alpha, transmittance):
    """Blend one Gaussian into the sixteen pixels of a block.

    Args:
        power: log2 of the unclamped alpha.
        raw_alpha: Unclamped alpha.
        transmittance: Transmittance before; negative where the pixel is finished.

    Returns:
        Clamped alpha; the Gaussian's weight alpha · transmittance, 0 where it is not blended; where it is blended; the
        transmittance after; the bits of the pixels that it finishes.
    """
    alpha = minimum(raw_alpha, ALPHA_LIMIT)
    inside = power >= LOG2_MIN_ALPHA
    weight = alpha * transmittance
    after = transmittance - weight
    blended = inside & (after >= TRANSMITTANCE_LIMIT)
    finished = inside & (after < TRANSMITTANCE_LIMIT)
    remaining = select(blended, after, select(finished, negate(absolute(transmittance)), transmittance))
    return alpha, select(blended, weight, np.float32(0)), blended, remaining, bits_of(finished)
