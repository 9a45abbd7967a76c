"""Backward pass of projection, sixteen Gaussians at a time: from sums over pixels to the inputs and the camera pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import gather_rows, load, load_rows, pointer, store, store_columns, take_ticket, transpose
from ggavatar.jit.simd import fma, lane_index_below, negate, select, splat, total
from ggavatar.jit.vectors import columns_3, columns_4, dot
from ggavatar.render.cpu.backward import (
    SUM_BLUE,
    SUM_DEPTH,
    SUM_GREEN,
    SUM_LOG_ALPHA,
    SUM_RED,
    SUM_U,
    SUM_UU,
    SUM_UV,
    SUM_V,
    SUM_VV,
    SUMS,
)
from ggavatar.render.cpu.binning import bin_pointers
from ggavatar.render.cpu.harmonics import (
    SCRATCH,
    clamp_gradient,
    direction,
    direction_gradient,
    fill_basis,
    load_coefficients,
    prefetch_colors,
    store_color_gradient,
)
from ggavatar.render.cpu.layout import (
    BLUE,
    CENTER,
    FOCAL,
    GREEN,
    RATIO_LIMITS,
    RECORD,
    RED,
    ROTATION,
    WHITEN_XX,
    WHITEN_XY,
    WHITEN_YY,
    cloud_pointers,
    combine,
    image_axes,
    in_gaussian_axes,
    rotation_columns,
    row,
    to_camera,
    unit_quaternion,
)
from ggavatar.render.cpu.projection import CHUNK, TWO_LN2, footprint_pointers

POSE = SCRATCH
"""Offset in the scratch memory of the sums for the pose gradient: rotation row by row, translation, camera center."""

POSE_SUMS = 15
"""Number of sums for the pose gradient, one vector each."""

GRADIENT_SCRATCH = SCRATCH + 16 * POSE_SUMS
"""Floats of scratch memory that a worker needs."""

TWO, HALF = np.float32(2), np.float32(0.5)


class Gradients(NamedTuple):
    """Gradients of the inputs, rows padded to a multiple of 16 except in `colors`; `poses` is [chunks, 15]."""

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    means2d: np.ndarray
    poses: np.ndarray


@kernel
def differentiate_chunks(tickets, scratches, cloud, view, footprints, bins, slots, gradients):
    """Kernel of one worker: differentiate chunks of Gaussians until none is left."""
    scratch = pointer(scratches, take_ticket(tickets, 1) * GRADIENT_SCRATCH)
    cloud, view, footprints = cloud_pointers(cloud), pointer(view, 0), footprint_pointers(footprints)
    bins = bin_pointers(bins)
    slots, gradients, count = pointer(slots, 0), gradient_pointers(gradients), cloud.rows
    chunks = (count + CHUNK - 1) // CHUNK
    chunk = take_ticket(tickets, 0)
    while chunk < chunks:
        for number in range(POSE_SUMS):
            store(scratch, POSE + number * 16, splat(np.float32(0)))
        for first in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, count), 16):
            prefetch_colors(cloud.colors, cloud.coefficients, first + 2 * 16, count - 1)
            sums = gather_sums(scratch, bins, slots, first, count - 1)
            differentiate_group(scratch, cloud, view, footprints, sums, gradients, first)
        for number in range(POSE_SUMS):
            gradients.poses[chunk * POSE_SUMS + number] = total(load(scratch, POSE + number * 16))
        chunk = take_ticket(tickets, 0)


@inlined
def gradient_pointers(gradients):
    """The gradients with pointers instead of arrays."""
    means, quats, scales = pointer(gradients.means, 0), pointer(gradients.quats, 0), pointer(gradients.scales, 0)
    opacities, colors = pointer(gradients.opacities, 0), pointer(gradients.colors, 0)
    means2d, poses = pointer(gradients.means2d, 0), pointer(gradients.poses, 0)
    return Gradients(means, quats, scales, opacities, colors, means2d, poses)


@inlined
def gather_sums(scratch, bins, slots, first, last):
    """Add up the slots of sixteen Gaussians, one vector per sum."""
    for number in range(16):
        sums = splat(np.float32(0))
        index = first + number
        if index <= last:
            for slot in range(bins.slots[index], bins.slots[index + 1]):
                sums = sums + load(slots, slot * SUMS)
        store(scratch, number * 16, sums)
    return transpose(load_rows(scratch, 0, 15, 16, 0))


@inlined
def differentiate_group(scratch, cloud, view, footprints, sums, gradients, first):
    """Write all gradients of sixteen Gaussians; those of invisible ones are zero."""
    last = cloud.rows - 1
    zero = np.float32(0)
    seen = (load(footprints.radii, first) > zero) & lane_index_below(last - first + 1)
    records = transpose(load_rows(footprints.records, first, first + 15, RECORD, 0))
    mean2d = (
        TWO_LN2 * records[WHITEN_XX] * sums[SUM_U],
        TWO_LN2 * fma(records[WHITEN_XY], sums[SUM_U], records[WHITEN_YY] * sums[SUM_V]),
    )
    shape = covariance_gradient(records, sums)
    colors = color_gradients_of(cloud, records, sums, seen)
    means = columns_3(cloud.means, first, last)
    point_gradient = differentiate_shape(
        scratch, cloud, view, (first, last), (mean2d, shape, sums[SUM_DEPTH], seen), means, gradients
    )
    center_gradient = differentiate_colors(scratch, cloud, view, gradients.colors, colors, means, (first, last))
    add_to_pose(scratch, 12, center_gradient)
    mean = to_world_axes(view, point_gradient)
    mean = (mean[0] - center_gradient[0], mean[1] - center_gradient[1], mean[2] - center_gradient[2])
    store_columns(gradients.means, first * 3, mean)
    store_columns(gradients.means2d, first * 2, (select(seen, mean2d[0], zero), select(seen, mean2d[1], zero)))
    opacities = gather_rows(cloud.opacities, first, last, 1, 0)
    store(gradients.opacities, first, select(seen, sums[SUM_LOG_ALPHA] / opacities, zero))


@inlined
def covariance_gradient(records, sums):
    """Entries xx, xy, yy of the symmetric gradient of the image covariance: ½ Σ w · (conic d)(conic d)ᵀ."""
    xx, xy, yy = records[WHITEN_XX], records[WHITEN_XY], records[WHITEN_YY]
    factor = HALF * TWO_LN2 * TWO_LN2
    mixed = fma(xy, sums[SUM_UU], yy * sums[SUM_UV])
    last = fma(xy, mixed, yy * fma(xy, sums[SUM_UV], yy * sums[SUM_VV]))
    return xx * xx * sums[SUM_UU] * factor, xx * mixed * factor, last * factor


@inlined
def color_gradients_of(cloud, records, sums, seen):
    """Gradients of the colors; those of harmonics before the clamp at zero."""
    zero = np.float32(0)
    red = select(seen, sums[SUM_RED], zero)
    green = select(seen, sums[SUM_GREEN], zero)
    blue = select(seen, sums[SUM_BLUE], zero)
    if cloud.coefficients == 0:
        return red, green, blue
    return clamp_gradient((records[RED], records[GREEN], records[BLUE]), (red, green, blue))


@inlined
def differentiate_shape(scratch, cloud, view, rows, incoming, means, gradients):
    """Write the gradients of scales and quats, add to the pose's; returns that of the camera-space positions."""
    mean2d, shape, depth, seen = incoming
    first, last = rows
    point = to_camera(view, means)
    unit, inverse_length = unit_quaternion(columns_4(cloud.quats, first, last))
    scales = columns_3(cloud.scales, first, last)
    columns = rotation_columns(unit)
    axis_0, axis_1, ratios = image_axes(view, point)
    own_0, own_1 = in_gaussian_axes(axis_0, columns), in_gaussian_axes(axis_1, columns)
    spread_0, spread_1 = multiply(own_0, scales), multiply(own_1, scales)
    d_spread_0 = combine(TWO * shape[0], spread_0, TWO * shape[1], spread_1)
    d_spread_1 = combine(TWO * shape[1], spread_0, TWO * shape[2], spread_1)
    d_scales = add(multiply(d_spread_0, own_0), multiply(d_spread_1, own_1))
    store_columns(gradients.scales, first * 3, masked(seen, d_scales))
    d_own_0, d_own_1 = multiply(d_spread_0, scales), multiply(d_spread_1, scales)
    d_quats = quaternion_gradient(unit, inverse_length, (axis_0, axis_1), d_own_0, d_own_1)
    store_quats(gradients.quats, first, seen, d_quats)
    d_axis_0 = masked(seen, from_gaussian_axes(columns, d_own_0))
    d_axis_1 = masked(seen, from_gaussian_axes(columns, d_own_1))
    d_point = masked(seen, point_gradient(view, point, ratios, (d_axis_0, d_axis_1), mean2d, depth))
    add_pose(scratch, view, (means, d_point), ratios, d_axis_0, d_axis_1, seen)
    return d_point


@inlined
def store_quats(target, first, seen, quats):
    """Write the gradient of sixteen quaternions."""
    zero = np.float32(0)
    w, x = select(seen, quats[0], zero), select(seen, quats[1], zero)
    store_columns(target, first * 4, (w, x, select(seen, quats[2], zero), select(seen, quats[3], zero)))


@inlined
def multiply(a, b):
    """Elementwise product of triples."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inlined
def add(a, b):
    """Sum of triples."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def masked(seen, a):
    """A triple of vectors, set to zero where a Gaussian is not seen."""
    zero = np.float32(0)
    return select(seen, a[0], zero), select(seen, a[1], zero), select(seen, a[2], zero)


@inlined
def from_gaussian_axes(columns, own):
    """Rotate a triple from the Gaussian's own axes to the world's."""
    x = fma(columns[0][0], own[0], fma(columns[1][0], own[1], columns[2][0] * own[2]))
    y = fma(columns[0][1], own[0], fma(columns[1][1], own[1], columns[2][1] * own[2]))
    z = fma(columns[0][2], own[0], fma(columns[1][2], own[1], columns[2][2] * own[2]))
    return x, y, z


@inlined
def to_world_axes(view, point):
    """Rotate a triple from the camera's axes to the world's."""
    r0, r1, r2 = row(view, ROTATION), row(view, ROTATION + 3), row(view, ROTATION + 6)
    x = fma(point[0], r0[0], fma(point[1], r1[0], point[2] * r2[0]))
    y = fma(point[0], r0[1], fma(point[1], r1[1], point[2] * r2[1]))
    z = fma(point[0], r0[2], fma(point[1], r1[2], point[2] * r2[2]))
    return x, y, z


@inlined
def quaternion_gradient(unit, inverse_length, axes, d_own_0, d_own_1):
    """Gradient of quaternions of any length, given that of own = axis · rotation."""
    w, x, y, z = unit
    c0 = combine(d_own_0[0], axes[0], d_own_1[0], axes[1])
    c1 = combine(d_own_0[1], axes[0], d_own_1[1], axes[1])
    c2 = combine(d_own_0[2], axes[0], d_own_1[2], axes[1])
    turn_x, turn_y, turn_z = c1[2] - c2[1], c2[0] - c0[2], c0[1] - c1[0]
    xy, xz, yz = c1[0] + c0[1], c2[0] + c0[2], c2[1] + c1[2]
    d_w = TWO * fma(x, turn_x, fma(y, turn_y, z * turn_z))
    d_x = TWO * (fma(w, turn_x, fma(y, xy, z * xz)) - TWO * x * (c1[1] + c2[2]))
    d_y = TWO * (fma(w, turn_y, fma(x, xy, z * yz)) - TWO * y * (c0[0] + c2[2]))
    d_z = TWO * (fma(w, turn_z, fma(x, xz, y * yz)) - TWO * z * (c0[0] + c1[1]))
    along = fma(w, d_w, fma(x, d_x, fma(y, d_y, z * d_z)))
    return (
        (d_w - along * w) * inverse_length,
        (d_x - along * x) * inverse_length,
        (d_y - along * y) * inverse_length,
        (d_z - along * z) * inverse_length,
    )


@inlined
def point_gradient(view, point, ratios, d_axes, mean2d, depth):
    """Gradient of camera-space positions through the pixel position, the Jacobian and the depth."""
    inverse, ratio_x, ratio_y = ratios
    limits_x = view[RATIO_LIMITS], view[RATIO_LIMITS + 1]
    limits_y = view[RATIO_LIMITS + 2], view[RATIO_LIMITS + 3]
    axis_x, axis_y, axis_z = row(view, ROTATION), row(view, ROTATION + 3), row(view, ROTATION + 6)
    position_x, position_y = (point[0], inverse, ratio_x), (point[1], inverse, ratio_y)
    d_x, d_inverse_x = image_axis_gradient(view[FOCAL], limits_x, axis_x, axis_z, position_x, (d_axes[0], mean2d[0]))
    d_y, d_inverse_y = image_axis_gradient(
        view[FOCAL + 1], limits_y, axis_y, axis_z, position_y, (d_axes[1], mean2d[1])
    )
    return d_x, d_y, fma(negate(inverse * inverse), d_inverse_x + d_inverse_y, depth)


@inlined
def image_axis_gradient(focal, limits, axis, axis_z, position, incoming):
    """For the x or the y axis of the image: gradient of the camera-space coordinate and of 1 / z."""
    coordinate, inverse, ratio = position
    d_axis, d_mean = incoming
    d_slant = dot(d_axis, axis_z)
    d_scale = dot(d_axis, axis) - ratio * d_slant
    unclamped = coordinate * inverse
    inside = (unclamped >= limits[0]) & (unclamped <= limits[1])
    d_ratio = select(inside, negate(inverse * focal * d_slant), np.float32(0)) + d_mean * focal
    return d_ratio * inverse, fma(d_ratio, coordinate, d_scale * focal)


@inlined
def add_to_pose(scratch, number, triple):
    """Add three vectors to the sums for the pose, from number `number` on."""
    for part in range(3):
        offset = POSE + (number + part) * 16
        store(scratch, offset, load(scratch, offset) + triple[part])


@inlined
def add_pose(scratch, view, positions, ratios, d_axis_0, d_axis_1, seen):
    """Add the gradients of the rows of the camera's rotation and of its translation."""
    means, d_point = positions
    inverse, ratio_x, ratio_y = ratios
    scale_x, scale_y = inverse * view[FOCAL], inverse * view[FOCAL + 1]
    slant_x, slant_y = negate(scale_x * ratio_x), negate(scale_y * ratio_y)
    slanted = add(masked(seen, scale(slant_x, d_axis_0)), masked(seen, scale(slant_y, d_axis_1)))
    add_to_pose(scratch, 0, add(scale(d_point[0], means), masked(seen, scale(scale_x, d_axis_0))))
    add_to_pose(scratch, 3, add(scale(d_point[1], means), masked(seen, scale(scale_y, d_axis_1))))
    add_to_pose(scratch, 6, add(scale(d_point[2], means), slanted))
    add_to_pose(scratch, 9, d_point)


@inlined
def scale(factor, a):
    """A triple times a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def differentiate_colors(scratch, cloud, view, target, colors, means, rows):
    """Write the gradient of the colors; returns that of the camera center, one per Gaussian."""
    first, last = rows
    zero = splat(np.float32(0))
    if cloud.degree <= 0:
        fill_basis(scratch, (zero, zero, zero), 0)
        store_color_gradient(scratch, cloud, target, colors, first, last)
        return zero, zero, zero
    unit, inverse = direction(means, row(view, CENTER))
    load_coefficients(scratch, cloud, first, last)
    d_unit = direction_gradient(scratch, unit, cloud.degree, colors)
    along = dot(unit, d_unit)
    fill_basis(scratch, unit, cloud.degree)
    store_color_gradient(scratch, cloud, target, colors, first, last)
    x = fma(negate(along), unit[0], d_unit[0])
    y = fma(negate(along), unit[1], d_unit[1])
    z = fma(negate(along), unit[2], d_unit[2])
    return negate(x * inverse), negate(y * inverse), negate(z * inverse)
