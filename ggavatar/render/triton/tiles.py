"""What drawing a tile and differentiating it share: pixels, the tile's list, and the blending of a few Gaussians."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function
from ggavatar.render.triton.layout import (
    LOG_OPACITY,
    MAX_ALPHA,
    MIN_ALPHA,
    MIN_TRANSMITTANCE,
    RECORD,
    TILE,
    WHITEN_XX,
    WHITEN_XY,
    WHITEN_YY,
    X,
    Y,
)


@device_function
def tile_pixels(tile, tiles_x, width, height):
    """Column, row and index of the pixels of a tile, and which are in the image."""
    lane = tl.arange(0, TILE * TILE)
    column, row = (tile % tiles_x) * TILE + lane % TILE, (tile // tiles_x) * TILE + lane // TILE
    return column, row, row * width + column, (column < width) & (row < height)


@device_function
def tile_list(starts, ends, tile, rows, capacity):
    """First and end of a tile's entries, and whether the pairs overflowed, so that it walks through all Gaussians."""
    overflowed = tl.load(ends + rows - 1) > capacity
    first, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    return tl.where(overflowed, 0, first), tl.where(overflowed, rows, end), overflowed


@device_function
def listed_rows(entries, order, k, there, overflowed):
    """Rows of the entries `k` of a tile's list, or of the Gaussians of rank `k` in the order by depth."""
    listed = tl.load(entries + k, mask=there & (not overflowed), other=0)
    return tl.where(overflowed, tl.load(order + k, mask=there & overflowed, other=0).to(tl.int32), listed)


@device_function
def alphas_at(at, there, x, y):
    """Of pixels × Gaussians at records `at`: whitened offsets u and v, alpha before its limit, and alpha."""
    xx, xy = tl.load(at + WHITEN_XX, mask=there, other=0.0), tl.load(at + WHITEN_XY, mask=there, other=0.0)
    yy = tl.load(at + WHITEN_YY, mask=there, other=0.0)
    dx = x[:, None] - tl.load(at + X, mask=there, other=0.0)[None, :]
    dy = y[:, None] - tl.load(at + Y, mask=there, other=0.0)[None, :]
    u, v = xx[None, :] * dx + xy[None, :] * dy, yy[None, :] * dy
    raw = tl.exp2(tl.load(at + LOG_OPACITY, mask=there, other=-1e3)[None, :] - u * u - v * v)
    return u, v, raw, tl.where(raw >= MIN_ALPHA, tl.minimum(raw, MAX_ALPHA), 0.0)


@device_function
def blended(alpha, transmittance, alive):
    """Alpha of the Gaussians that are blended, their weights, and the pixels' state behind them.

    `transmittance` and `alive` are those of the pixels before the first Gaussian. A pixel is finished before the
    Gaussian that would reduce its transmittance below 1e-4.
    """
    after = transmittance[:, None] * tl.cumprod(1 - alpha, axis=1)
    alpha = tl.where((after >= MIN_TRANSMITTANCE) & (alive[:, None] > 0), alpha, 0.0)
    through = tl.cumprod(1 - alpha, axis=1)
    weight = alpha * (transmittance[:, None] * (through / (1 - alpha)))
    alive = tl.where(tl.min(after, axis=1) < MIN_TRANSMITTANCE, 0, alive)
    return alpha, weight, transmittance * tl.min(through, axis=1), alive


@device_function
def record_of(records, row):
    """The record of a Gaussian."""
    return records + row.to(tl.int64) * RECORD
