"""Sixteen Gaussians at a time: positions, rotations and image-plane shapes, shared by projection and its gradient.

The formulas are those of `ggavatar.render.projection`; a tuple of vectors holds a small matrix row by row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined
from ggavatar.jit.memory import pointer
from ggavatar.jit.simd import absolute, fma, maximum, minimum, negate, sqrt
from ggavatar.jit.vectors import dot
from ggavatar.render.constants import LOW_PASS, TINY_NORM

# Places in the float32 array that describes a view.
ROTATION, TRANSLATION, FOCAL, PRINCIPAL, LIMITS, CENTER, SIZE, TILES, BACKGROUND, VIEW_LENGTH = (
    0,
    9,
    12,
    14,
    16,
    20,
    23,
    25,
    27,
    30,
)


class Cloud(NamedTuple):
    """The Gaussians as flat float32 arrays or pointers to them.

    `rows` is the number of Gaussians; `coefficients` is the number of harmonics held per channel, 0 for RGB;
    `degree` the highest one to evaluate.
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    rows: int
    coefficients: int
    degree: int


@inlined
def bare_cloud(cloud):
    """The cloud with pointers instead of arrays."""
    means, quats, scales = pointer(cloud.means, 0), pointer(cloud.quats, 0), pointer(cloud.scales, 0)
    opacities, colors = pointer(cloud.opacities, 0), pointer(cloud.colors, 0)
    return Cloud(means, quats, scales, opacities, colors, cloud.rows, cloud.coefficients, cloud.degree)


@inlined
def combine(x, a, y, b):
    """X · a + y · b for triples a, b."""
    return fma(x, a[0], y * b[0]), fma(x, a[1], y * b[1]), fma(x, a[2], y * b[2])


@inlined
def row(view, place):
    """Three consecutive numbers of a view."""
    return view[place], view[place + 1], view[place + 2]


@inlined
def to_camera(view, means):
    """Camera-space positions of world positions, m."""
    x = fma(means[0], view[0], fma(means[1], view[1], fma(means[2], view[2], view[9])))
    y = fma(means[0], view[3], fma(means[1], view[4], fma(means[2], view[5], view[10])))
    z = fma(means[0], view[6], fma(means[1], view[7], fma(means[2], view[8], view[11])))
    return x, y, z


@inlined
def unit_quaternion(quat):
    """The quaternion at length 1 and 1 / length; any length is fine, also 0 or one that overflows squared."""
    w, x, y, z = quat
    largest = maximum(maximum(absolute(w), absolute(x)), maximum(absolute(y), absolute(z)))
    largest = maximum(largest, np.float32(1e-30))
    share = np.float32(1.0) / largest
    a, b, c, d = w * share, x * share, y * share, z * share
    length = largest * sqrt(fma(a, a, fma(b, b, fma(c, c, d * d))))
    scale = np.float32(1.0) / maximum(length, np.float32(TINY_NORM))
    return (w * scale, x * scale, y * scale, z * scale), scale


@inlined
def rotation_columns(quat):
    """Columns of the rotation matrix of a unit quaternion wxyz."""
    w, x, y, z = quat
    one, two = np.float32(1.0), np.float32(2.0)
    xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    column_0 = (one - two * (yy + zz), two * (xy + wz), two * (xz - wy))
    column_1 = (two * (xy - wz), one - two * (xx + zz), two * (yz + wx))
    column_2 = (two * (xz + wy), two * (yz - wx), one - two * (xx + yy))
    return column_0, column_1, column_2


@inlined
def image_axes(view, point):
    """Rows of J W: how a step in the world moves a pixel, with the ratios x/z, y/z held inside the widened view."""
    inverse = np.float32(1.0) / point[2]
    ratio_x = minimum(maximum(point[0] * inverse, view[16]), view[17])
    ratio_y = minimum(maximum(point[1] * inverse, view[18]), view[19])
    scale_x, scale_y = inverse * view[12], inverse * view[13]
    slant_x, slant_y = negate(scale_x * ratio_x), negate(scale_y * ratio_y)
    axis_0 = combine(scale_x, row(view, 0), slant_x, row(view, 6))
    axis_1 = combine(scale_y, row(view, 3), slant_y, row(view, 6))
    return axis_0, axis_1, (inverse, ratio_x, ratio_y)


@inlined
def turned(axis, columns):
    """An axis of the image expressed in the Gaussian's own axes."""
    return dot(axis, columns[0]), dot(axis, columns[1]), dot(axis, columns[2])


@inlined
def covariance(axis_0, axis_1, scales):
    """Entries xx, xy, yy and determinant of the low-passed image covariance, from axes in the Gaussian's own frame."""
    m0 = (axis_0[0] * scales[0], axis_0[1] * scales[1], axis_0[2] * scales[2])
    m1 = (axis_1[0] * scales[0], axis_1[1] * scales[1], axis_1[2] * scales[2])
    low_pass = np.float32(LOW_PASS)
    square_0, square_1, xy = dot(m0, m0), dot(m1, m1), dot(m0, m1)
    a = fma(m0[1], m1[2], negate(m0[2] * m1[1]))
    b = fma(m0[2], m1[0], negate(m0[0] * m1[2]))
    c = fma(m0[0], m1[1], negate(m0[1] * m1[0]))
    determinant = dot((a, b, c), (a, b, c)) + fma(square_0 + square_1, low_pass, low_pass * low_pass)
    return square_0 + low_pass, xy, square_1 + low_pass, determinant
