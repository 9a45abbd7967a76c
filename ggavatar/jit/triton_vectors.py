"""Vectors and quaternions of a block of rows, for Triton kernels: tuples of three or four blocks."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function


@device_function
def load_3(base, row, mask):
    """Three consecutive numbers of every row of a matrix [N, 3]; 0 where `mask` is false."""
    at = base + row * 3
    second = tl.load(at + 1, mask=mask, other=0.0)
    return tl.load(at, mask=mask, other=0.0), second, tl.load(at + 2, mask=mask, other=0.0)


@device_function
def load_4(base, row, mask):
    """Quaternions of rows of [N, 4]; identity where `mask` is false."""
    at = base + row * 4
    w, x = tl.load(at, mask=mask, other=1.0), tl.load(at + 1, mask=mask, other=0.0)
    return w, x, tl.load(at + 2, mask=mask, other=0.0), tl.load(at + 3, mask=mask, other=0.0)


@device_function
def store_3(base, row, mask, a):
    """Write three numbers to every row of a matrix [N, 3]."""
    at = base + row * 3
    tl.store(at, a[0], mask=mask)
    tl.store(at + 1, a[1], mask=mask)
    tl.store(at + 2, a[2], mask=mask)


@device_function
def store_4(base, row, mask, a):
    """Write four numbers to every row of a matrix [N, 4]."""
    at = base + row * 4
    tl.store(at, a[0], mask=mask)
    tl.store(at + 1, a[1], mask=mask)
    tl.store(at + 2, a[2], mask=mask)
    tl.store(at + 3, a[3], mask=mask)


@device_function
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device_function
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@device_function
def scaled(factor, a):
    """A number times a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


@device_function
def product(a, b):
    """Elementwise product of vectors."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@device_function
def combined(x, a, y, b):
    """The linear combination x · a + y · b of vectors."""
    return x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]


@device_function
def added(a, b):
    """Sum of vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@device_function
def masked(mask, a):
    """A vector, zero where `mask` is false."""
    return tl.where(mask, a[0], 0.0), tl.where(mask, a[1], 0.0), tl.where(mask, a[2], 0.0)


@device_function
def normalized(q):
    """A quaternion divided by its length, and 1 / length, at least as `torch.nn.functional.normalize` limits it."""
    inverse = 1.0 / tl.maximum(tl.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), 1e-12)
    return (q[0] * inverse, q[1] * inverse, q[2] * inverse, q[3] * inverse), inverse


@device_function
def through_normalized(upstream, unit, inverse):
    """Gradient of a quaternion, given that of `normalized`."""
    along = upstream[0] * unit[0] + upstream[1] * unit[1] + upstream[2] * unit[2] + upstream[3] * unit[3]
    w, x = (upstream[0] - along * unit[0]) * inverse, (upstream[1] - along * unit[1]) * inverse
    return w, x, (upstream[2] - along * unit[2]) * inverse, (upstream[3] - along * unit[3]) * inverse


@device_function
def conjugate(q):
    """The inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@device_function
def hamilton(a, b):
    """Hamilton product of quaternions wxyz: rotates by `b`, then by `a`."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    return w, x, y, a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


@device_function
def quaternion_of(row_0, row_1, row_2):
    """Unit quaternion of a rotation matrix, from its largest component, the first of equal ones."""
    ww, xx = 1 + row_0[0] + row_1[1] + row_2[2], 1 + row_0[0] - row_1[1] - row_2[2]
    yy, zz = 1 - row_0[0] + row_1[1] - row_2[2], 1 - row_0[0] - row_1[1] + row_2[2]
    wx, wy, wz = row_2[1] - row_1[2], row_0[2] - row_2[0], row_1[0] - row_0[1]
    xy, xz, yz = row_1[0] + row_0[1], row_0[2] + row_2[0], row_2[1] + row_1[2]
    by_w = (ww >= xx) & (ww >= yy) & (ww >= zz)
    by_x, by_y = (xx >= yy) & (xx >= zz), yy >= zz
    w = tl.where(by_w, ww, tl.where(by_x, wx, tl.where(by_y, wy, wz)))
    x = tl.where(by_w, wx, tl.where(by_x, xx, tl.where(by_y, xy, xz)))
    y = tl.where(by_w, wy, tl.where(by_x, xy, tl.where(by_y, yy, yz)))
    z = tl.where(by_w, wz, tl.where(by_x, xz, tl.where(by_y, yz, zz)))
    return normalized((w, x, y, z))[0]
