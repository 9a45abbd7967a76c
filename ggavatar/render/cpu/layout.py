"""Memory layout of views and records, and geometry of sixteen Gaussians at a time, for projection and its gradient.

The formulas are those of `ggavatar.render.projection`; a tuple of vectors holds a small matrix row by row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined
from ggavatar.jit.memory import pointer
from ggavatar.jit.simd import absolute, fma, maximum, minimum, negate, sqrt
from ggavatar.jit.vectors import dot
from ggavatar.render.constants import LOW_PASS, MIN_NORM

TILE = 16
"""Pixels along a side of a tile."""

ROTATION, TRANSLATION, FOCAL, PRINCIPAL, RATIO_LIMITS = 0, 9, 12, 14, 16
CENTER, SIZE, TILES, BACKGROUND = 20, 23, 25, 27
"""Offsets in the float32 array that describes a view; x comes before y, and the limits of x/z before those of y/z.

The rotation is row-major, `CENTER` is the camera's position in the world, and `TILES` the numbers of tiles.
"""

WHITEN_XX, WHITEN_XY, WHITEN_YY, X, Y, OPACITY, RED, GREEN, BLUE, DEPTH, STEP_Y, STEP_X, REACH, RECORD = *range(13), 16
"""Offsets in the record of a Gaussian, and its length in floats (64 bytes).

WHITEN_XX, WHITEN_XY and WHITEN_YY are the upper triangle of the whitening matrix, not entries of the covariance:
u = WHITEN_XX dx + WHITEN_XY dy and v = WHITEN_YY dy give log2 alpha = OPACITY − u² − v². X and Y are the center in px,
OPACITY is log2 of the opacity, DEPTH camera z. STEP_Y is the y of the point with the smallest u² + v² on the line
dx = 1, STEP_X the x of that on dy = 1, and REACH log2 of 255 · opacity with a little slack.
"""


class Cloud(NamedTuple):
    """The Gaussians as flat float32 arrays or pointers to them.

    `rows` is the number of Gaussians, `coefficients` the number of stored harmonics per channel (0 for RGB), `degree`
    the highest degree to evaluate.
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
def cloud_pointers(cloud):
    """The cloud with pointers instead of arrays."""
    means, quats, scales = pointer(cloud.means, 0), pointer(cloud.quats, 0), pointer(cloud.scales, 0)
    opacities, colors = pointer(cloud.opacities, 0), pointer(cloud.colors, 0)
    return Cloud(means, quats, scales, opacities, colors, cloud.rows, cloud.coefficients, cloud.degree)


@inlined
def combine(x, a, y, b):
    """The linear combination x · a + y · b of triples a and b."""
    return fma(x, a[0], y * b[0]), fma(x, a[1], y * b[1]), fma(x, a[2], y * b[2])


@inlined
def row(view, offset):
    """Three consecutive numbers of a view."""
    return view[offset], view[offset + 1], view[offset + 2]


@inlined
def to_camera(view, means):
    """Camera-space positions of world positions, m."""
    r0, r1, r2 = row(view, ROTATION), row(view, ROTATION + 3), row(view, ROTATION + 6)
    x = fma(means[0], r0[0], fma(means[1], r0[1], fma(means[2], r0[2], view[TRANSLATION])))
    y = fma(means[0], r1[0], fma(means[1], r1[1], fma(means[2], r1[2], view[TRANSLATION + 1])))
    z = fma(means[0], r2[0], fma(means[1], r2[1], fma(means[2], r2[2], view[TRANSLATION + 2])))
    return x, y, z


@inlined
def unit_quaternion(quat):
    """The normalized quaternion and 1 / length; any length is allowed, even 0 or one whose square overflows."""
    w, x, y, z = quat
    largest = maximum(maximum(absolute(w), absolute(x)), maximum(absolute(y), absolute(z)))
    largest = maximum(largest, np.float32(1e-30))
    scale = np.float32(1.0) / largest
    a, b, c, d = w * scale, x * scale, y * scale, z * scale
    length = largest * sqrt(fma(a, a, fma(b, b, fma(c, c, d * d))))
    inverse_length = np.float32(1.0) / maximum(length, np.float32(MIN_NORM))
    return (w * inverse_length, x * inverse_length, y * inverse_length, z * inverse_length), inverse_length


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
    """Rows of J W, the derivative of the pixel position with respect to the world position; also 1/z, x/z and y/z.

    The ratios x/z and y/z are clamped to the widened view.
    """
    inverse = np.float32(1.0) / point[2]
    ratio_x = minimum(maximum(point[0] * inverse, view[RATIO_LIMITS]), view[RATIO_LIMITS + 1])
    ratio_y = minimum(maximum(point[1] * inverse, view[RATIO_LIMITS + 2]), view[RATIO_LIMITS + 3])
    scale_x, scale_y = inverse * view[FOCAL], inverse * view[FOCAL + 1]
    slant_x, slant_y = negate(scale_x * ratio_x), negate(scale_y * ratio_y)
    axis_0 = combine(scale_x, row(view, ROTATION), slant_x, row(view, ROTATION + 6))
    axis_1 = combine(scale_y, row(view, ROTATION + 3), slant_y, row(view, ROTATION + 6))
    return axis_0, axis_1, (inverse, ratio_x, ratio_y)


@inlined
def in_gaussian_axes(axis, columns):
    """A row of J W in the Gaussian's own axes, given the columns of its rotation."""
    return dot(axis, columns[0]), dot(axis, columns[1]), dot(axis, columns[2])


@inlined
def covariance(axis_0, axis_1, scales):
    """Entries xx, xy, yy and determinant of the low-passed image covariance, from J W in the Gaussian's own axes."""
    m0 = (axis_0[0] * scales[0], axis_0[1] * scales[1], axis_0[2] * scales[2])
    m1 = (axis_1[0] * scales[0], axis_1[1] * scales[1], axis_1[2] * scales[2])
    low_pass = np.float32(LOW_PASS)
    square_0, square_1, xy = dot(m0, m0), dot(m1, m1), dot(m0, m1)
    a = fma(m0[1], m1[2], negate(m0[2] * m1[1]))
    b = fma(m0[2], m1[0], negate(m0[0] * m1[2]))
    c = fma(m0[0], m1[1], negate(m0[1] * m1[0]))
    determinant = dot((a, b, c), (a, b, c)) + fma(square_0 + square_1, low_pass, low_pass * low_pass)
    return square_0 + low_pass, xy, square_1 + low_pass, determinant
