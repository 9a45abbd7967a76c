"""Quaternions wxyz inside compiled kernels, as tuples of four numbers or vectors."""

from __future__ import annotations

import numpy as np

from ggavatar.jit.kernels import inlined


@inlined
def product(a, b):
    """Hamilton product of two quaternions."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
    )


@inlined
def conjugate(a):
    """The conjugate, which for a unit quaternion is the inverse rotation."""
    return a[0], -a[1], -a[2], -a[3]


@inlined
def inverse_length(a):
    """Reciprocal of the length, which is clamped to at least 1e-12 as in torch's `normalize`."""
    length = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3])
    return np.float32(1) / max(length, np.float32(1e-12))


@inlined
def scaled(a, factor):
    """The quaternion times a factor."""
    return a[0] * factor, a[1] * factor, a[2] * factor, a[3] * factor


@inlined
def normalize_backward(gradient, unit, inverse):
    """Gradient of a quaternion, given that of its normalization `unit` and the reciprocal of its length, `inverse`."""
    along = gradient[0] * unit[0] + gradient[1] * unit[1] + gradient[2] * unit[2] + gradient[3] * unit[3]
    return (
        (gradient[0] - along * unit[0]) * inverse,
        (gradient[1] - along * unit[1]) * inverse,
        (gradient[2] - along * unit[2]) * inverse,
        (gradient[3] - along * unit[3]) * inverse,
    )


@inlined
def row(array, n):
    """Row `n` of an array [N, 4]."""
    return array[n, 0], array[n, 1], array[n, 2], array[n, 3]


@inlined
def from_matrix(m, n):
    """Unit quaternion of matrix `n` of an array [N, 3, 3], from its largest component as in `matrix_to_quaternion`."""
    one = np.float32(1)
    m00, m11, m22 = m[n, 0, 0], m[n, 1, 1], m[n, 2, 2]
    x, y, z = m[n, 2, 1] - m[n, 1, 2], m[n, 0, 2] - m[n, 2, 0], m[n, 1, 0] - m[n, 0, 1]
    xy, xz, yz = m[n, 1, 0] + m[n, 0, 1], m[n, 0, 2] + m[n, 2, 0], m[n, 2, 1] + m[n, 1, 2]
    s0, s1, s2, s3 = one + m00 + m11 + m22, one + m00 - m11 - m22, one - m00 + m11 - m22, one - m00 - m11 + m22
    best, found = s0, (s0, x, y, z)
    if s1 > best:
        best, found = s1, (x, s1, xy, xz)
    if s2 > best:
        best, found = s2, (y, xy, s2, yz)
    if s3 > best:
        found = (z, xz, yz, s3)
    return scaled(found, inverse_length(found))
