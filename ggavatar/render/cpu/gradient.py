"""Gradient of projection, sixteen Gaussians at a time: from sums over pixels to the inputs and the camera pose."""

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
    SUM_RED,
    SUM_U,
    SUM_UU,
    SUM_UV,
    SUM_V,
    SUM_VV,
    SUM_WEIGHT,
    SUMS,
)
from ggavatar.render.cpu.binning import bare_bins
from ggavatar.render.cpu.harmonics import (
    SCRATCH,
    direction,
    direction_gradient,
    fill_basis,
    load_coefficients,
    passed,
    prefetch_colors,
    store_color_gradient,
)
from ggavatar.render.cpu.layout import (
    CENTER,
    bare_cloud,
    combine,
    image_axes,
    rotation_columns,
    row,
    to_camera,
    turned,
    unit_quaternion,
)
from ggavatar.render.cpu.projection import BLUE, CHUNK, GREEN, RECORD, RED, TWO_LN2, XX, XY, YY, bare_footprints

POSE = SCRATCH
"""Where in the scratch the pose gradient is summed: rotation row by row, translation, camera center."""

POSE_SUMS = 15
GRADIENT_SCRATCH = SCRATCH + 16 * POSE_SUMS
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
    """Differentiate chunks of Gaussians until none is left."""
    scratch = pointer(scratches, take_ticket(tickets, 1) * GRADIENT_SCRATCH)
    cloud, view, footprints, bins = bare_cloud(cloud), pointer(view, 0), bare_footprints(footprints), bare_bins(bins)
    slots, gradients, count = pointer(slots, 0), bare_gradients(gradients), cloud.rows
    chunks = (count + CHUNK - 1) // CHUNK
    chunk = take_ticket(tickets, 0)
    while chunk < chunks:
        for number in range(POSE_SUMS):
            store(scratch, POSE + number * 16, splat(np.float32(0)))
        for first in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, count), 16):
            prefetch_colors(cloud.colors, cloud.coefficients, first + 2 * 16, count - 1)
            differentiate_group(
                scratch, cloud, view, footprints, gather_sums(scratch, bins, slots, first, count - 1), gradients, first
            )
        for number in range(POSE_SUMS):
            gradients.poses[chunk * POSE_SUMS + number] = total(load(scratch, POSE + number * 16))
        chunk = take_ticket(tickets, 0)


@inlined
def bare_gradients(gradients):
    """The gradients with pointers instead of arrays."""
    means, quats, scales = pointer(gradients.means, 0), pointer(gradients.quats, 0), pointer(gradients.scales, 0)
    opacities, colors, means2d = (
        pointer(gradients.opacities, 0),
        pointer(gradients.colors, 0),
        pointer(gradients.means2d, 0),
    )
    return Gradients(means, quats, scales, opacities, colors, means2d, pointer(gradients.poses, 0))


@inlined
def gather_sums(scratch, bins, slots, first, last):
    """The slots of sixteen Gaussians added up, one vector per sum."""
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
    """Write all gradients of sixteen Gaussians; those that are not visible get zero."""
    last = cloud.rows - 1
    zero = np.float32(0)
    seen = (load(footprints.radii, first) > zero) & lane_index_below(last - first + 1)
    records = transpose(load_rows(footprints.records, first, first + 15, RECORD, 0))
    mean2d = (TWO_LN2 * records[XX] * sums[SUM_U], TWO_LN2 * fma(records[XY], sums[SUM_U], records[YY] * sums[SUM_V]))
    shape = covariance_gradient(records, sums)
    colors = passed_colors(cloud, records, sums, seen)
    means = columns_3(cloud.means, first, last)
    point_gradient = differentiate_shape(
        scratch, cloud, view, (first, last), (mean2d, shape, sums[SUM_DEPTH], seen), means, gradients
    )
    center_gradient = differentiate_colors(scratch, cloud, view, gradients.colors, colors, means, (first, last))
    add(scratch, 12, center_gradient)
    mean = dot_columns(view, point_gradient)
    mean = (mean[0] - center_gradient[0], mean[1] - center_gradient[1], mean[2] - center_gradient[2])
    store_columns(gradients.means, first * 3, mean)
    store_columns(gradients.means2d, first * 2, (select(seen, mean2d[0], zero), select(seen, mean2d[1], zero)))
    opacities = gather_rows(cloud.opacities, first, last, 1, 0)
    store(gradients.opacities, first, select(seen, sums[SUM_WEIGHT] / opacities, zero))


@inlined
def covariance_gradient(records, sums):
    """Entries xx, xy, yy of the symmetric gradient of the image covariance: ½ Σ weight · (conic d)(conic d)ᵀ."""
    xx, xy, yy = records[XX], records[XY], records[YY]
    factor = HALF * TWO_LN2 * TWO_LN2
    mixed = fma(xy, sums[SUM_UU], yy * sums[SUM_UV])
    last = fma(xy, mixed, yy * fma(xy, sums[SUM_UV], yy * sums[SUM_VV]))
    return xx * xx * sums[SUM_UU] * factor, xx * mixed * factor, last * factor


@inlined
def passed_colors(cloud, records, sums, seen):
    """Gradients of the colors, before the clamp where there is one."""
    zero = np.float32(0)
    red = select(seen, sums[SUM_RED], zero)
    green = select(seen, sums[SUM_GREEN], zero)
    blue = select(seen, sums[SUM_BLUE], zero)
    if cloud.coefficients == 0:
        return red, green, blue
    return passed((records[RED], records[GREEN], records[BLUE]), (red, green, blue))


@inlined
def differentiate_shape(scratch, cloud, view, rows, incoming, means, gradients):
    """Write the gradients of scales and quats, add to that of the pose, return that of the camera-space positions."""
    mean2d, shape, depth, seen = incoming
    first, last = rows
    point = to_camera(view, means)
    unit, inverse_length = unit_quaternion(columns_4(cloud.quats, first, last))
    scales = columns_3(cloud.scales, first, last)
    columns = rotation_columns(unit)
    axis_0, axis_1, ratios = image_axes(view, point)
    own_0, own_1 = turned(axis_0, columns), turned(axis_1, columns)
    spread_0, spread_1 = times(own_0, scales), times(own_1, scales)
    d_spread_0 = combine(TWO * shape[0], spread_0, TWO * shape[1], spread_1)
    d_spread_1 = combine(TWO * shape[1], spread_0, TWO * shape[2], spread_1)
    d_scales = plus(times(d_spread_0, own_0), times(d_spread_1, own_1))
    store_columns(gradients.scales, first * 3, kept(seen, d_scales))
    d_own_0, d_own_1 = times(d_spread_0, scales), times(d_spread_1, scales)
    d_quats = quaternion_gradient(unit, inverse_length, (axis_0, axis_1), d_own_0, d_own_1)
    store_quats(gradients.quats, first, seen, d_quats)
    d_axis_0, d_axis_1 = kept(seen, back(columns, d_own_0)), kept(seen, back(columns, d_own_1))
    d_point = kept(seen, point_gradient(view, point, ratios, (d_axis_0, d_axis_1), mean2d, depth))
    add_pose(scratch, view, (means, d_point), ratios, d_axis_0, d_axis_1, seen)
    return d_point


@inlined
def store_quats(target, first, seen, quats):
    """Write the gradient of sixteen quaternions."""
    zero = np.float32(0)
    w, x = select(seen, quats[0], zero), select(seen, quats[1], zero)
    store_columns(target, first * 4, (w, x, select(seen, quats[2], zero), select(seen, quats[3], zero)))


@inlined
def times(a, b):
    """Elementwise product of triples."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inlined
def plus(a, b):
    """Sum of triples."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def kept(seen, a):
    """A triple with zero where not seen."""
    zero = np.float32(0)
    return select(seen, a[0], zero), select(seen, a[1], zero), select(seen, a[2], zero)


@inlined
def back(columns, own):
    """From a Gaussian's own axes to the world's."""
    x = fma(columns[0][0], own[0], fma(columns[1][0], own[1], columns[2][0] * own[2]))
    y = fma(columns[0][1], own[0], fma(columns[1][1], own[1], columns[2][1] * own[2]))
    z = fma(columns[0][2], own[0], fma(columns[1][2], own[1], columns[2][2] * own[2]))
    return x, y, z


@inlined
def dot_columns(view, point):
    """From camera axes to world axes."""
    x = fma(point[0], view[0], fma(point[1], view[3], point[2] * view[6]))
    y = fma(point[0], view[1], fma(point[1], view[4], point[2] * view[7]))
    z = fma(point[0], view[2], fma(point[1], view[5], point[2] * view[8]))
    return x, y, z


@inlined
def quaternion_gradient(unit, inverse_length, axes, d_own_0, d_own_1):
    """Gradient of quaternions of any length, through own = axis · rotation."""
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
    d_x, inverse_x = one_axis(
        view[12], (view[16], view[17]), row(view, 0), row(view, 6), (point[0], inverse, ratio_x), (d_axes[0], mean2d[0])
    )
    d_y, inverse_y = one_axis(
        view[13], (view[18], view[19]), row(view, 3), row(view, 6), (point[1], inverse, ratio_y), (d_axes[1], mean2d[1])
    )
    return d_x, d_y, fma(negate(inverse * inverse), inverse_x + inverse_y, depth)


@inlined
def one_axis(focal, limits, straight, forward, place, incoming):
    """For the x or the y axis of the image: gradient of the camera-space coordinate and of 1 / z."""
    coordinate, inverse, ratio = place
    d_axis, d_mean = incoming
    d_slant = dot(d_axis, forward)
    d_scale = dot(d_axis, straight) - ratio * d_slant
    plain = coordinate * inverse
    free = (plain >= limits[0]) & (plain <= limits[1])
    d_ratio = select(free, negate(inverse * focal * d_slant), np.float32(0)) + d_mean * focal
    return d_ratio * inverse, fma(d_ratio, coordinate, d_scale * focal)


@inlined
def add(scratch, number, triple):
    """Add three vectors to the running pose sums."""
    for offset in range(3):
        place = POSE + (number + offset) * 16
        store(scratch, place, load(scratch, place) + triple[offset])


@inlined
def add_pose(scratch, view, positions, ratios, d_axis_0, d_axis_1, seen):
    """Add the gradients of the rows of the camera's rotation and of its translation."""
    means, d_point = positions
    inverse, ratio_x, ratio_y = ratios
    scale_x, scale_y = inverse * view[12], inverse * view[13]
    slant_x, slant_y = negate(scale_x * ratio_x), negate(scale_y * ratio_y)
    turned_2 = plus(kept(seen, scaled(slant_x, d_axis_0)), kept(seen, scaled(slant_y, d_axis_1)))
    add(scratch, 0, plus(scaled(d_point[0], means), kept(seen, scaled(scale_x, d_axis_0))))
    add(scratch, 3, plus(scaled(d_point[1], means), kept(seen, scaled(scale_y, d_axis_1))))
    add(scratch, 6, plus(scaled(d_point[2], means), turned_2))
    add(scratch, 9, d_point)


@inlined
def scaled(factor, a):
    """A triple times a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def differentiate_colors(scratch, cloud, view, target, colors, means, rows):
    """Write the gradient of the colors; returns that of the camera center, per Gaussian."""
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
    x, y, z = (
        fma(negate(along), unit[0], d_unit[0]),
        fma(negate(along), unit[1], d_unit[1]),
        fma(negate(along), unit[2], d_unit[2]),
    )
    return negate(x * inverse), negate(y * inverse), negate(z * inverse)
