"""Spherical harmonics of a block of Gaussians: colors, and the gradients of coefficients and directions."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function
from ggavatar.render import harmonics

C0, C1 = tl.constexpr(harmonics.C0), tl.constexpr(harmonics.C1)
C20, C21, C22 = (tl.constexpr(value) for value in harmonics.C2)
C30, C31, C32, C33, C34 = (tl.constexpr(value) for value in harmonics.C3)


@device_function
def direction(mean, center):
    """Unit vector from the camera to the Gaussian, and the reciprocal distance."""
    x, y, z = mean[0] - center[0], mean[1] - center[1], mean[2] - center[2]
    inverse = 1.0 / tl.maximum(tl.sqrt(x * x + y * y + z * z), 1e-20)
    return (x * inverse, y * inverse, z * inverse), inverse


@device_function
def basis(unit, TERM: tl.constexpr):
    """Value of one of the sixteen basis functions."""
    x, y, z = unit
    if TERM == 0:
        value = tl.full(x.shape, C0, tl.float32)
    elif TERM == 1:
        value = -C1 * y
    elif TERM == 2:
        value = C1 * z
    elif TERM == 3:
        value = -C1 * x
    elif TERM == 4:
        value = C20 * x * y
    elif TERM == 5:
        value = -C20 * y * z
    elif TERM == 6:
        value = C21 * (2 * z * z - x * x - y * y)
    elif TERM == 7:
        value = -C20 * x * z
    elif TERM == 8:
        value = C22 * (x * x - y * y)
    else:
        value = _cubic(x, y, z, TERM)
    return value


@device_function
def _cubic(x, y, z, TERM: tl.constexpr):
    """Value of one of the seven basis functions of degree 3."""
    if TERM == 9:
        value = -C30 * y * (3 * x * x - y * y)
    elif TERM == 10:
        value = C31 * x * y * z
    elif TERM == 11:
        value = -C32 * y * (4 * z * z - x * x - y * y)
    elif TERM == 12:
        value = C33 * z * (2 * z * z - 3 * x * x - 3 * y * y)
    elif TERM == 13:
        value = -C32 * x * (4 * z * z - x * x - y * y)
    elif TERM == 14:
        value = C34 * z * (x * x - y * y)
    else:
        value = -C30 * x * (x * x - 3 * y * y)
    return value


@device_function
def colors_of(coefficients, rows, mask, unit, HELD: tl.constexpr, DEGREE: tl.constexpr):
    """Colors before the clamp at zero; `coefficients` is [N, HELD, 3]."""
    at = coefficients + rows.to(tl.int64) * (3 * HELD)
    red, green, blue = (
        tl.full(rows.shape, 0.5, tl.float32),
        tl.full(rows.shape, 0.5, tl.float32),
        tl.full(rows.shape, 0.5, tl.float32),
    )
    for term in tl.static_range((DEGREE + 1) * (DEGREE + 1)):
        value = basis(unit, term)
        red += value * tl.load(at + 3 * term, mask=mask, other=0.0)
        green += value * tl.load(at + 3 * term + 1, mask=mask, other=0.0)
        blue += value * tl.load(at + 3 * term + 2, mask=mask, other=0.0)
    return red, green, blue


@device_function
def store_color_gradient(target, rows, mask, unit, to_color, HELD: tl.constexpr, DEGREE: tl.constexpr):
    """Write the gradient of the coefficients; those above the degree get zeros."""
    at = target + rows.to(tl.int64) * (3 * HELD)
    for term in tl.static_range(HELD):
        value = tl.zeros(rows.shape, tl.float32)
        if term < (DEGREE + 1) * (DEGREE + 1):
            value = basis(unit, term)
        tl.store(at + 3 * term, value * to_color[0], mask=mask)
        tl.store(at + 3 * term + 1, value * to_color[1], mask=mask)
        tl.store(at + 3 * term + 2, value * to_color[2], mask=mask)


@device_function
def _to_basis(at, mask, to_color, TERM: tl.constexpr):
    """Gradient of one basis value."""
    red, green = tl.load(at + 3 * TERM, mask=mask, other=0.0), tl.load(at + 3 * TERM + 1, mask=mask, other=0.0)
    return red * to_color[0] + green * to_color[1] + tl.load(at + 3 * TERM + 2, mask=mask, other=0.0) * to_color[2]


@device_function
def to_direction(coefficients, rows, mask, unit, to_color, HELD: tl.constexpr, DEGREE: tl.constexpr):
    """Gradient of the unit direction."""
    at = coefficients + rows.to(tl.int64) * (3 * HELD)
    x, y, z = unit
    dy = -C1 * _to_basis(at, mask, to_color, 1)
    dz = C1 * _to_basis(at, mask, to_color, 2)
    dx = -C1 * _to_basis(at, mask, to_color, 3)
    if DEGREE >= 2:
        g4, g5 = C20 * _to_basis(at, mask, to_color, 4), -C20 * _to_basis(at, mask, to_color, 5)
        g6, g7 = C21 * _to_basis(at, mask, to_color, 6), -C20 * _to_basis(at, mask, to_color, 7)
        g8 = C22 * _to_basis(at, mask, to_color, 8)
        dx += g4 * y + g7 * z + 2 * x * (g8 - g6)
        dy += g4 * x + g5 * z - 2 * y * (g8 + g6)
        dz += g5 * y + g7 * x + 4 * z * g6
    if DEGREE >= 3:
        cubic_x, cubic_y, cubic_z = _cubic_to_direction(at, mask, unit, to_color)
        dx, dy, dz = dx + cubic_x, dy + cubic_y, dz + cubic_z
    return dx, dy, dz


@device_function
def _cubic_to_direction(at, mask, unit, to_color):
    """The part of `to_direction` that comes from the seven cubic terms."""
    x, y, z = unit
    xx, yy, zz = x * x, y * y, z * z
    g9 = -C30 * _to_basis(at, mask, to_color, 9)
    dx, dy = 6 * x * y * g9, 3 * (xx - yy) * g9
    g10 = C31 * _to_basis(at, mask, to_color, 10)
    dx, dy, dz = dx + y * z * g10, dy + x * z * g10, x * y * g10
    g11 = -C32 * _to_basis(at, mask, to_color, 11)
    dx, dy, dz = dx - 2 * x * y * g11, dy + (4 * zz - xx - 3 * yy) * g11, dz + 8 * y * z * g11
    g12 = C33 * _to_basis(at, mask, to_color, 12)
    dx, dy, dz = dx - 6 * x * z * g12, dy - 6 * y * z * g12, dz + (6 * zz - 3 * (xx + yy)) * g12
    g13 = -C32 * _to_basis(at, mask, to_color, 13)
    dx, dy, dz = dx + (4 * zz - 3 * xx - yy) * g13, dy - 2 * x * y * g13, dz + 8 * x * z * g13
    g14 = C34 * _to_basis(at, mask, to_color, 14)
    dx, dy, dz = dx + 2 * x * z * g14, dy - 2 * y * z * g14, dz + (xx - yy) * g14
    g15 = -C30 * _to_basis(at, mask, to_color, 15)
    return dx + 3 * (xx - yy) * g15, dy - 6 * x * y * g15, dz
