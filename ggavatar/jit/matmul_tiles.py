"""Small matrix products inside compiled kernels, in tiles of 4 rows by 64 (or 16) columns that stay in registers.

Matrices are flat; `b` and `c` are row-major with a width that is a multiple of 16, `a` may have any strides.
"""

from __future__ import annotations

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import load, store
from ggavatar.jit.simd import LANES, fma, splat


@inlined
def _tile_64(a, at, strides, depth, b, c, c_at, width):
    """Add 4 × depth of `a` (strides per row and column) times depth × 64 of `b`, from its first element on, to `c`."""
    c00, c01, c02, c03 = load(c, c_at), load(c, c_at + 16), load(c, c_at + 32), load(c, c_at + 48)
    r1, r2, r3 = c_at + width, c_at + 2 * width, c_at + 3 * width
    c10, c11, c12, c13 = load(c, r1), load(c, r1 + 16), load(c, r1 + 32), load(c, r1 + 48)
    c20, c21, c22, c23 = load(c, r2), load(c, r2 + 16), load(c, r2 + 32), load(c, r2 + 48)
    c30, c31, c32, c33 = load(c, r3), load(c, r3 + 16), load(c, r3 + 32), load(c, r3 + 48)
    b_at, (row_step, step) = np.int64(0), strides
    a0, a1, a2, a3 = at, at + row_step, at + 2 * row_step, at + 3 * row_step
    for _ in range(depth):
        b0, b1, b2, b3 = load(b, b_at), load(b, b_at + 16), load(b, b_at + 32), load(b, b_at + 48)
        f = splat(a[np.uint64(a0)])
        c00, c01, c02, c03 = fma(f, b0, c00), fma(f, b1, c01), fma(f, b2, c02), fma(f, b3, c03)
        f = splat(a[np.uint64(a1)])
        c10, c11, c12, c13 = fma(f, b0, c10), fma(f, b1, c11), fma(f, b2, c12), fma(f, b3, c13)
        f = splat(a[np.uint64(a2)])
        c20, c21, c22, c23 = fma(f, b0, c20), fma(f, b1, c21), fma(f, b2, c22), fma(f, b3, c23)
        f = splat(a[np.uint64(a3)])
        c30, c31, c32, c33 = fma(f, b0, c30), fma(f, b1, c31), fma(f, b2, c32), fma(f, b3, c33)
        a0, a1, a2, a3, b_at = a0 + step, a1 + step, a2 + step, a3 + step, b_at + width
    _store_4(c, c_at, c00, c01, c02, c03)
    _store_4(c, r1, c10, c11, c12, c13)
    _store_4(c, r2, c20, c21, c22, c23)
    _store_4(c, r3, c30, c31, c32, c33)


@inlined
def _store_4(c, at, v0, v1, v2, v3):
    store(c, at, v0)
    store(c, at + 16, v1)
    store(c, at + 32, v2)
    store(c, at + 48, v3)


@inlined
def _tile_16(a, at, strides, depth, b, c, c_at, width):
    """As `_tile_64`, for 16 columns."""
    r1, r2, r3 = c_at + width, c_at + 2 * width, c_at + 3 * width
    c0, c1, c2, c3 = load(c, c_at), load(c, r1), load(c, r2), load(c, r3)
    b_at, (row_step, step) = np.int64(0), strides
    a0, a1, a2, a3 = at, at + row_step, at + 2 * row_step, at + 3 * row_step
    for _ in range(depth):
        b0 = load(b, b_at)
        c0, c1 = fma(a[np.uint64(a0)], b0, c0), fma(a[np.uint64(a1)], b0, c1)
        c2, c3 = fma(a[np.uint64(a2)], b0, c2), fma(a[np.uint64(a3)], b0, c3)
        a0, a1, a2, a3, b_at = a0 + step, a1 + step, a2 + step, a3 + step, b_at + width
    store(c, c_at, c0)
    store(c, r1, c1)
    store(c, r2, c2)
    store(c, r3, c3)


@kernel
def add_product(a, row_step, step, rows, depth, b, columns, c):
    """`c` += `a` · `b`: rows × depth (any strides) by depth × columns.

    `rows` must be a multiple of 4 and `columns` of 16.
    """
    strides = (np.int64(row_step), np.int64(step))
    for row in range(0, rows, 4):
        column = 0
        while column + 64 <= columns:
            _tile_64(a, row * row_step, strides, depth, b[column:], c, row * columns + column, columns)
            column += 64
        while column < columns:
            _tile_16(a, row * row_step, strides, depth, b[column:], c, row * columns + column, columns)
            column += LANES
