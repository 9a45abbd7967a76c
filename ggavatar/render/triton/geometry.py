"""Geometry of a block of Gaussians for projection and its gradient; the formulas of `ggavatar.render.projection`.

A tuple of three blocks is a vector, a tuple of three such tuples a matrix row by row.
"""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function
from ggavatar.jit.triton_vectors import combined, dot
from ggavatar.render.triton.layout import CLAMP_MARGIN, LOW_PASS, MIN_NORM


@device_function
def camera_rotation(pose):
    """The rows of the rotation of a pose [4, 4]."""
    row_0 = tl.load(pose), tl.load(pose + 1), tl.load(pose + 2)
    row_1 = tl.load(pose + 4), tl.load(pose + 5), tl.load(pose + 6)
    return row_0, row_1, (tl.load(pose + 8), tl.load(pose + 9), tl.load(pose + 10))


@device_function
def camera_translation(pose):
    """The translation of a pose [4, 4]."""
    return tl.load(pose + 3), tl.load(pose + 7), tl.load(pose + 11)


@device_function
def camera_center(rotation, translation):
    """Position of the camera in the world: −Rᵀ t."""
    x, y, z = from_rows(rotation, translation)
    return -x, -y, -z


@device_function
def axis_view(intrinsics, AXIS: tl.constexpr, size):
    """Of an image axis: focal length and principal point (px), and the limits of x/z or y/z in the widened view."""
    focal, principal = tl.load(intrinsics + 4 * AXIS), tl.load(intrinsics + 3 * AXIS + 2)
    margin = CLAMP_MARGIN * 0.5 * size / focal
    return focal, principal, -principal / focal - margin, (size - principal) / focal + margin


@device_function
def from_rows(rows, a):
    """The transposed matrix times a vector: Σ aᵢ · rowᵢ."""
    row_0, row_1, row_2 = rows
    x = a[0] * row_0[0] + a[1] * row_1[0] + a[2] * row_2[0]
    y = a[0] * row_0[1] + a[1] * row_1[1] + a[2] * row_2[1]
    return x, y, a[0] * row_0[2] + a[1] * row_1[2] + a[2] * row_2[2]


@device_function
def onto_rows(rows, a):
    """The matrix times a vector."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


@device_function
def unit_quaternion(quat):
    """The normalized quaternion and 1 / length; any length is allowed, even 0 or one whose square overflows."""
    w, x, y, z = quat
    largest = tl.maximum(tl.maximum(tl.abs(w), tl.abs(x)), tl.maximum(tl.abs(y), tl.abs(z)))
    largest = tl.maximum(largest, 1e-30)
    a, b, c, d = w / largest, x / largest, y / largest, z / largest
    length = largest * tl.sqrt(a * a + b * b + c * c + d * d)
    inverse = 1.0 / tl.maximum(length, MIN_NORM)
    return (w * inverse, x * inverse, y * inverse, z * inverse), inverse


@device_function
def rotation_columns(unit):
    """The columns of the rotation matrix of a unit quaternion wxyz."""
    w, x, y, z = unit
    column_0 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    column_1 = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    return column_0, column_1, (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))


@device_function
def image_axis(axis, axis_z, position, inverse, view):
    """A row of J W, the derivative of a pixel coordinate with respect to the world position, and the clamped ratio."""
    focal, _, low, high = view
    ratio = tl.minimum(tl.maximum(position * inverse, low), high)
    return combined(focal * inverse, axis, -focal * inverse * ratio, axis_z), ratio


@device_function
def covariance(spread_0, spread_1):
    """Entries xx, xy, yy and determinant of the low-passed image covariance, from the rows of M = J W R S.

    The determinant is a sum of squared minors, without the cancellation that makes long thin Gaussians vanish.
    """
    square_0, square_1, xy = dot(spread_0, spread_0), dot(spread_1, spread_1), dot(spread_0, spread_1)
    a = spread_0[1] * spread_1[2] - spread_0[2] * spread_1[1]
    b = spread_0[2] * spread_1[0] - spread_0[0] * spread_1[2]
    c = spread_0[0] * spread_1[1] - spread_0[1] * spread_1[0]
    determinant = a * a + b * b + c * c + ((square_0 + square_1) * LOW_PASS + LOW_PASS * LOW_PASS)
    return square_0 + LOW_PASS, xy, square_1 + LOW_PASS, determinant


@device_function
def whitening(xx, xy, yy, determinant):
    """The upper triangle of the whitening matrix of an image covariance: u = a dx + b dy, v = c dy."""
    root, inverse = tl.sqrt(yy), 1.0 / tl.sqrt(determinant)
    return root * inverse, -xy * inverse / root, 1.0 / root
