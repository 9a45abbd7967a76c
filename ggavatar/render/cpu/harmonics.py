"""Spherical harmonics of sixteen Gaussians at a time: colors, and the gradients of coefficients and directions."""

from __future__ import annotations

import numpy as np

from ggavatar.jit.kernels import inlined
from ggavatar.jit.memory import gather_rows, load, load_rows, prefetch, scatter_rows, store, stream_rows, transpose
from ggavatar.jit.simd import fma, maximum, negate, select, splat, sqrt
from ggavatar.jit.vectors import columns_3, dot
from ggavatar.render import harmonics

C0, C1 = np.float32(harmonics.C0), np.float32(harmonics.C1)
C20, C21, C22 = (np.float32(value) for value in harmonics.C2)
C30, C31, C32, C33, C34 = (np.float32(value) for value in harmonics.C3)
TWO, THREE, FOUR, SIX, EIGHT = (np.float32(value) for value in (2, 3, 4, 6, 8))
BASIS, SCRATCH = 48 * 16, 64 * 16
"""Offset of the basis values in a worker's scratch memory, behind 48 coefficients, and its size, all in floats."""


@inlined
def direction(means, center):
    """Unit vectors from the camera to the Gaussians and the reciprocal distances."""
    x, y, z = means[0] - center[0], means[1] - center[1], means[2] - center[2]
    inverse = np.float32(1.0) / maximum(sqrt(dot((x, y, z), (x, y, z))), np.float32(1e-20))
    return (x * inverse, y * inverse, z * inverse), inverse


@inlined
def fill_basis(scratch, unit, degree):
    """Write the (degree + 1)² basis values to the scratch memory."""
    x, y, z = unit
    store(scratch, BASIS, splat(C0))
    if degree >= 1:
        store(scratch, BASIS + 16, y * negate(C1))
        store(scratch, BASIS + 32, z * C1)
        store(scratch, BASIS + 48, x * negate(C1))
    xx, yy, zz = x * x, y * y, z * z
    if degree >= 2:
        store(scratch, BASIS + 64, x * y * C20)
        store(scratch, BASIS + 80, y * z * negate(C20))
        store(scratch, BASIS + 96, (TWO * zz - xx - yy) * C21)
        store(scratch, BASIS + 112, x * z * negate(C20))
        store(scratch, BASIS + 128, (xx - yy) * C22)
    if degree >= 3:
        round_term = FOUR * zz - xx - yy
        store(scratch, BASIS + 144, y * (THREE * xx - yy) * negate(C30))
        store(scratch, BASIS + 160, x * y * z * C31)
        store(scratch, BASIS + 176, y * round_term * negate(C32))
        store(scratch, BASIS + 192, z * (TWO * zz - THREE * (xx + yy)) * C33)
        store(scratch, BASIS + 208, x * round_term * negate(C32))
        store(scratch, BASIS + 224, z * (xx - yy) * C34)
        store(scratch, BASIS + 240, x * (xx - THREE * yy) * negate(C30))


@inlined
def prefetch_colors(colors, coefficients, first, last):
    """Prefetch the colors of a later group of sixteen; without this, most of the time is spent waiting for memory."""
    size = 3 * max(coefficients, 1)
    for offset in range(first * size, min(first + 16, last + 1) * size, 16):
        prefetch(colors, offset)


@inlined
def load_coefficients(scratch, cloud, first, last):
    """Load the coefficients in use of sixteen Gaussians into the scratch memory, one vector per coefficient."""
    used = 3 * (cloud.degree + 1) * (cloud.degree + 1)
    stride = 3 * cloud.coefficients
    if stride == 48:
        for chunk in range(0, used, 16):
            columns = transpose(load_rows(cloud.colors, first, last, stride, chunk))
            for number in range(16):
                store(scratch, (chunk + number) * 16, columns[number])
    else:
        for number in range(used):
            store(scratch, number * 16, gather_rows(cloud.colors, first, last, stride, number))


@inlined
def harmonic_colors(scratch, terms):
    """Colors before the clamp: the sum of coefficient times basis plus one half."""
    red, green, blue = splat(np.float32(0.5)), splat(np.float32(0.5)), splat(np.float32(0.5))
    for term in range(terms):
        value = load(scratch, BASIS + term * 16)
        red = fma(value, load(scratch, term * 48), red)
        green = fma(value, load(scratch, term * 48 + 16), green)
        blue = fma(value, load(scratch, term * 48 + 32), blue)
    return red, green, blue


@inlined
def colors_of(scratch, cloud, center, means, first, last):
    """Colors of sixteen Gaussians seen from the camera, and a vector that is NaN or infinite where an input was."""
    if cloud.coefficients == 0:
        red, green, blue = columns_3(cloud.colors, first, last)
        return (red, green, blue), red + green + blue
    unit, _ = direction(means, center)
    load_coefficients(scratch, cloud, first, last)
    fill_basis(scratch, unit, cloud.degree)
    red, green, blue = harmonic_colors(scratch, (cloud.degree + 1) * (cloud.degree + 1))
    zero = np.float32(0)
    # `maximum` returns zero for NaN and zero, so faults are detected before the clamp.
    return (maximum(red, zero), maximum(green, zero), maximum(blue, zero)), red + green + blue


@inlined
def store_color_gradient(scratch, cloud, gradient, color_gradients, first, last):
    """Write the gradient of the colors or coefficients of sixteen Gaussians; overwrites the scratch memory."""
    red, green, blue = color_gradients
    stride = 3 * max(cloud.coefficients, 1)
    used = 3 * (cloud.degree + 1) * (cloud.degree + 1)
    if cloud.coefficients == 0:
        store(scratch, 0, red)
        store(scratch, 16, green)
        store(scratch, 32, blue)
        used = 3
    else:
        for term in range((cloud.degree + 1) * (cloud.degree + 1)):
            value = load(scratch, BASIS + term * 16)
            store(scratch, term * 48, value * red)
            store(scratch, term * 48 + 16, value * green)
            store(scratch, term * 48 + 32, value * blue)
    for number in range(used, stride):
        store(scratch, number * 16, splat(np.float32(0)))
    if stride == 48:
        for chunk in range(0, 48, 16):
            stream_rows(gradient, first, last, stride, chunk, transpose(load_rows(scratch, chunk, chunk + 15, 16, 0)))
    else:
        for number in range(stride):
            scatter_rows(gradient, first, last, stride, number, load(scratch, number * 16))


@inlined
def basis_gradient(scratch, term, color_gradients):
    """Gradient of one basis value."""
    offset = term * 48
    return dot(color_gradients, (load(scratch, offset), load(scratch, offset + 16), load(scratch, offset + 32)))


@inlined
def direction_gradient(scratch, unit, degree, color_gradients):
    """Gradient of the unit directions; the scratch memory holds the coefficients."""
    x, y, z = unit
    dx, dy, dz = splat(np.float32(0)), splat(np.float32(0)), splat(np.float32(0))
    if degree >= 1:
        dy = basis_gradient(scratch, 1, color_gradients) * negate(C1)
        dz = basis_gradient(scratch, 2, color_gradients) * C1
        dx = basis_gradient(scratch, 3, color_gradients) * negate(C1)
    if degree >= 2:
        g4 = basis_gradient(scratch, 4, color_gradients) * C20
        g5 = basis_gradient(scratch, 5, color_gradients) * negate(C20)
        g6 = basis_gradient(scratch, 6, color_gradients) * C21
        g7 = basis_gradient(scratch, 7, color_gradients) * negate(C20)
        g8 = basis_gradient(scratch, 8, color_gradients) * C22
        dx = dx + g4 * y + g7 * z + TWO * x * (g8 - g6)
        dy = dy + g4 * x + g5 * z - TWO * y * (g8 + g6)
        dz = dz + g5 * y + g7 * x + FOUR * z * g6
    if degree >= 3:
        cubic = _cubic_gradient(scratch, unit, color_gradients)
        dx, dy, dz = dx + cubic[0], dy + cubic[1], dz + cubic[2]
    return dx, dy, dz


@inlined
def _cubic_gradient(scratch, unit, color_gradients):
    """The part of `direction_gradient` that comes from the seven cubic terms."""
    x, y, z = unit
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    g9 = basis_gradient(scratch, 9, color_gradients) * negate(C30)
    g10 = basis_gradient(scratch, 10, color_gradients) * C31
    g11 = basis_gradient(scratch, 11, color_gradients) * negate(C32)
    g12 = basis_gradient(scratch, 12, color_gradients) * C33
    g13 = basis_gradient(scratch, 13, color_gradients) * negate(C32)
    g14 = basis_gradient(scratch, 14, color_gradients) * C34
    g15 = basis_gradient(scratch, 15, color_gradients) * negate(C30)
    dx = g9 * (SIX * xy) + g10 * yz - g11 * (TWO * xy) - g12 * (SIX * xz)
    dx = dx + g13 * (FOUR * zz - THREE * xx - yy) + g14 * (TWO * xz) + g15 * (THREE * (xx - yy))
    dy = g9 * (THREE * (xx - yy)) + g10 * xz + g11 * (FOUR * zz - xx - THREE * yy) - g12 * (SIX * yz)
    dy = dy - g13 * (TWO * xy) - g14 * (TWO * yz) - g15 * (SIX * xy)
    dz = g10 * xy + g11 * (EIGHT * yz) + g12 * (SIX * zz - THREE * (xx + yy)) + g13 * (EIGHT * xz) + g14 * (xx - yy)
    return dx, dy, dz


@inlined
def clamp_gradient(colors, gradients):
    """Gradients of the colors before the clamp at zero, given the clamped colors."""
    zero = np.float32(0)
    red = select(colors[0] > zero, gradients[0], zero)
    green = select(colors[1] > zero, gradients[1], zero)
    return red, green, select(colors[2] > zero, gradients[2], zero)
