"""The backward kernel of projection: from sums over pixels to the inputs and the camera pose."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import added, combined, dot, load_3, load_4, masked, product, scaled, store_3
from ggavatar.render.triton.geometry import (
    axis_view,
    camera_center,
    camera_rotation,
    camera_translation,
    covariance,
    from_rows,
    image_axis,
    onto_rows,
    rotation_columns,
    unit_quaternion,
    whitening,
)
from ggavatar.render.triton.harmonics import direction, store_color_gradient, to_direction
from ggavatar.render.triton.layout import (
    BLUE,
    GREEN,
    POSE_SUMS,
    RECORD,
    RED,
    SUMS,
    TO_BLUE,
    TO_DEPTH,
    TO_GREEN,
    TO_LOG_ALPHA,
    TO_RED,
    TO_U,
    TO_UU,
    TO_UV,
    TO_V,
    TO_VV,
    TWO_LN2,
    WHITEN,
)


@device_kernel
def differentiate_gaussians(
    means, quats, scales, opacities, colors, pose, intrinsics,
    records, order, ends, counts, radii, sums,
    to_means, to_quats, to_scales, to_opacities, to_colors, to_means2d, to_poses,
    rows, capacity, width, height,
    HELD: tl.constexpr, DEGREE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the gradients of a block of Gaussians in order of depth, and its sums for the pose [programs, POSE_SUMS].

    Reads the sums of pairs [capacity, SUMS], those of a Gaussian one after the other.
    """
    rank = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = rank < rows
    row = tl.load(order + rank, mask=alive, other=0).to(tl.int32)
    seen = alive & (tl.load(radii + row, mask=alive, other=0.0) > 0)
    first, count = places_of(ends, counts, rank, row, alive, rows, capacity)
    to_color, to_depth, to_opacity, to_uv, to_square = _gathered(sums, first, count)

    mean, scale = load_3(means, row, alive), load_3(scales, row, alive)
    unit, inverse_length = unit_quaternion(load_4(quats, row, alive))
    rotation, translation = camera_rotation(pose), camera_translation(pose)
    x, y, depth = onto_rows(rotation, mean)
    x, y, depth = x + translation[0], y + translation[1], depth + translation[2]
    inverse = 1.0 / depth
    view_x, view_y = axis_view(intrinsics, 0, width), axis_view(intrinsics, 1, height)
    axis_0, ratio_x = image_axis(rotation[0], rotation[2], x, inverse, view_x)
    axis_1, ratio_y = image_axis(rotation[1], rotation[2], y, inverse, view_y)
    columns = rotation_columns(unit)
    own_0, own_1 = onto_rows(columns, axis_0), onto_rows(columns, axis_1)
    spread_0, spread_1 = product(own_0, scale), product(own_1, scale)
    xx, xy, yy, determinant = covariance(spread_0, spread_1)
    a, b, c = whitening(xx, xy, yy, determinant)
    to_x, to_y, shape_xx, shape_xy, shape_yy = _to_image_shape(a, b, c, to_uv, to_square)
    to_spread_0 = combined(2 * shape_xx, spread_0, 2 * shape_xy, spread_1)
    to_spread_1 = combined(2 * shape_xy, spread_0, 2 * shape_yy, spread_1)
    to_scale = added(product(to_spread_0, own_0), product(to_spread_1, own_1))
    store_3(to_scales, row, alive, masked(seen, to_scale))
    to_own_0, to_own_1 = product(to_spread_0, scale), product(to_spread_1, scale)
    _store_quaternion_gradient(
        to_quats, row, alive, seen, (unit, inverse_length), (axis_0, axis_1), (to_own_0, to_own_1)
    )
    to_axis_0, to_axis_1 = masked(seen, from_rows(columns, to_own_0)), masked(seen, from_rows(columns, to_own_1))

    point_x, through_x = _to_axis_position(to_axis_0, to_x, rotation[0], rotation[2], x, inverse, ratio_x, view_x)
    point_y, through_y = _to_axis_position(to_axis_1, to_y, rotation[1], rotation[2], y, inverse, ratio_y, view_y)
    to_point = masked(seen, (point_x, point_y, to_depth - inverse * inverse * (through_x + through_y)))
    to_center = _differentiate_colors(
        colors, records, to_colors, row, alive, seen, direction(mean, camera_center(rotation, translation)), to_color,
        HELD, DEGREE,
    )  # fmt: skip
    to_mean = combined(1.0, from_rows(rotation, to_point), -1.0, to_center)
    store_3(to_means, row, alive, to_mean)
    tl.store(to_means2d + 2 * row, tl.where(seen, to_x, 0.0), mask=alive)
    tl.store(to_means2d + 2 * row + 1, tl.where(seen, to_y, 0.0), mask=alive)
    opacity = tl.load(opacities + row, mask=alive, other=1.0)
    tl.store(to_opacities + row, tl.where(seen, to_opacity / opacity, 0.0), mask=alive)

    scale_x, scale_y = tl.where(seen, inverse * view_x[0], 0.0), tl.where(seen, inverse * view_y[0], 0.0)
    slanted = combined(-scale_x * ratio_x, to_axis_0, -scale_y * ratio_y, to_axis_1)
    at = to_poses + tl.program_id(0) * POSE_SUMS
    _sum_3(at, combined(to_point[0], mean, scale_x, to_axis_0))
    _sum_3(at + 3, combined(to_point[1], mean, scale_y, to_axis_1))
    _sum_3(at + 6, added(scaled(to_point[2], mean), masked(seen, slanted)))
    _sum_3(at + 9, to_point)
    _sum_3(at + 12, to_center)


@device_function
def _differentiate_colors(
    colors, records, to_colors, row, alive, seen, towards, to_color, HELD: tl.constexpr, DEGREE: tl.constexpr
):
    """Write the gradient of the colors; returns that of the camera center."""
    unit, nearness = towards
    to_center = (tl.zeros_like(nearness), tl.zeros_like(nearness), tl.zeros_like(nearness))
    if HELD == 0:
        store_3(to_colors, row, alive, masked(seen, to_color))
    else:
        drawn = records + row * RECORD  # its colors are clamped at zero
        red = tl.where(tl.load(drawn + RED, mask=seen, other=0.0) > 0, to_color[0], 0.0)
        green = tl.where(tl.load(drawn + GREEN, mask=seen, other=0.0) > 0, to_color[1], 0.0)
        blue = tl.where(tl.load(drawn + BLUE, mask=seen, other=0.0) > 0, to_color[2], 0.0)
        before_clamp = (red, green, blue)
        store_color_gradient(to_colors, row, alive, unit, before_clamp, HELD, DEGREE)
        if DEGREE > 0:
            to_unit = to_direction(colors, row, alive, unit, before_clamp, HELD, DEGREE)
            across = combined(1.0, to_unit, -dot(unit, to_unit), unit)
            to_center = masked(seen, scaled(-nearness, across))
    return to_center


@device_function
def places_of(ends, counts, rank, row, alive, rows, capacity):
    """The first place of every Gaussian's sums, and their number: one place, its rank, if the pairs overflowed."""
    end, count = tl.load(ends + rank, mask=alive, other=0), tl.load(counts + row, mask=alive, other=0)
    overflowed = tl.load(ends + rows - 1) > capacity
    first = tl.where(overflowed, rank, (end - count).to(tl.int32))
    return first, tl.where(overflowed & alive, 1, count)


@device_function
def _gathered(sums, first, count):
    """The sums of every Gaussian over its tiles, in a fixed order: of color, depth, log alpha, (u, v), and squares."""
    zero = tl.zeros(first.shape, tl.float32)
    red, green, blue, depth, log_alpha = zero, zero, zero, zero, zero
    u, v, uu, uv, vv = zero, zero, zero, zero, zero
    for number in range(tl.max(count, axis=0)):
        there = number < count
        at = sums + (first + number).to(tl.int64) * SUMS
        red += tl.load(at + TO_RED, mask=there, other=0.0)
        green += tl.load(at + TO_GREEN, mask=there, other=0.0)
        blue += tl.load(at + TO_BLUE, mask=there, other=0.0)
        depth += tl.load(at + TO_DEPTH, mask=there, other=0.0)
        log_alpha += tl.load(at + TO_LOG_ALPHA, mask=there, other=0.0)
        u += tl.load(at + TO_U, mask=there, other=0.0)
        v += tl.load(at + TO_V, mask=there, other=0.0)
        uu += tl.load(at + TO_UU, mask=there, other=0.0)
        uv += tl.load(at + TO_UV, mask=there, other=0.0)
        vv += tl.load(at + TO_VV, mask=there, other=0.0)
    return (red, green, blue), depth, log_alpha, (u, v), (uu, uv, vv)


@device_function
def _to_image_shape(a, b, c, to_uv, to_square):
    """Gradients of the center in px, and xx, xy, yy of the symmetric gradient of the image covariance.

    The covariance's is ½ Σ w · (conic d)(conic d)ᵀ, where conic d = Wᵀ (u, v) with the whitening matrix W.
    """
    u, v = to_uv
    uu, uv, vv = to_square
    a, b, c = WHITEN * a, WHITEN * b, WHITEN * c
    factor = 0.5 * TWO_LN2 * TWO_LN2
    mixed = b * uu + c * uv
    last = b * mixed + c * (b * uv + c * vv)
    return TWO_LN2 * a * u, TWO_LN2 * (b * u + c * v), a * a * uu * factor, a * mixed * factor, last * factor


@device_function
def _to_axis_position(to_axis, to_center, axis, axis_z, position, inverse, ratio, view):
    """For the x or the y axis of the image: gradients of the camera-space coordinate and of 1 / z."""
    focal, _, low, high = view
    slant = dot(to_axis, axis_z)
    inside = (position * inverse >= low) & (position * inverse <= high)
    to_ratio = tl.where(inside, -inverse * focal * slant, 0.0) + to_center * focal
    return to_ratio * inverse, to_ratio * position + (dot(to_axis, axis) - ratio * slant) * focal


@device_function
def _store_quaternion_gradient(target, row, alive, seen, quaternion, axes, to_own):
    """Write the gradient of quaternions of any length, given that of own = axis · rotation."""
    unit, inverse_length = quaternion
    w, x, y, z = unit
    axis_0, axis_1 = axes
    own_0, own_1 = to_own
    c0 = combined(own_0[0], axis_0, own_1[0], axis_1)
    c1 = combined(own_0[1], axis_0, own_1[1], axis_1)
    c2 = combined(own_0[2], axis_0, own_1[2], axis_1)
    turn_x, turn_y, turn_z = c1[2] - c2[1], c2[0] - c0[2], c0[1] - c1[0]
    xy, xz, yz = c1[0] + c0[1], c2[0] + c0[2], c2[1] + c1[2]
    to_w = 2 * (x * turn_x + y * turn_y + z * turn_z)
    to_x = 2 * (w * turn_x + y * xy + z * xz - 2 * x * (c1[1] + c2[2]))
    to_y = 2 * (w * turn_y + x * xy + z * yz - 2 * y * (c0[0] + c2[2]))
    to_z = 2 * (w * turn_z + x * xz + y * yz - 2 * z * (c0[0] + c1[1]))
    along = w * to_w + x * to_x + y * to_y + z * to_z
    at = target + row * 4
    tl.store(at, tl.where(seen, (to_w - along * w) * inverse_length, 0.0), mask=alive)
    tl.store(at + 1, tl.where(seen, (to_x - along * x) * inverse_length, 0.0), mask=alive)
    tl.store(at + 2, tl.where(seen, (to_y - along * y) * inverse_length, 0.0), mask=alive)
    tl.store(at + 3, tl.where(seen, (to_z - along * z) * inverse_length, 0.0), mask=alive)


@device_function
def _sum_3(target, a):
    """Write the sums of a vector over the block."""
    tl.store(target, tl.sum(a[0], axis=0))
    tl.store(target + 1, tl.sum(a[1], axis=0))
    tl.store(target + 2, tl.sum(a[2], axis=0))


@device_kernel
def finish_pose(to_poses, pose, to_pose, programs, BLOCK: tl.constexpr):
    """Write the gradient [4, 4] of the pose from sums for its rotation, its translation and the camera center −Rᵀ t."""
    lane = tl.arange(0, POSE_SUMS)
    total = tl.zeros([POSE_SUMS], tl.float32)
    for first in range(0, programs, BLOCK):
        program = first + tl.arange(0, BLOCK)
        there = (program[:, None] < programs) & (lane[None, :] < 15)
        total += tl.sum(tl.load(to_poses + program[:, None] * POSE_SUMS + lane[None, :], mask=there, other=0.0), axis=0)
    center = _picked(total, 12), _picked(total, 13), _picked(total, 14)
    rotation, translation = camera_rotation(pose), camera_translation(pose)
    to_translation = onto_rows(rotation, center)
    for line in tl.static_range(3):
        for column in tl.static_range(3):
            moved = translation[line] * center[column]
            tl.store(to_pose + 4 * line + column, _picked(total, 3 * line + column) - moved)
        tl.store(to_pose + 4 * line + 3, _picked(total, 9 + line) - to_translation[line])
        tl.store(to_pose + 12 + line, 0.0)
    tl.store(to_pose + 15, 0.0)


@device_function
def _picked(values, INDEX: tl.constexpr):
    """One element of a block."""
    return tl.sum(tl.where(tl.arange(0, POSE_SUMS) == INDEX, values, 0.0), axis=0)
