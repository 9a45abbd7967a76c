"""Projection of Gaussians, sixteen at a time, into one 64-byte record per Gaussian with everything that tiles need.

Shapes come first, colors in a second pass: sorting into tiles needs no colors, so one thread can sort while the others
evaluate harmonics.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import (
    gather_rows,
    pointer,
    scatter_rows,
    store,
    store_boxes,
    store_columns,
    store_rows,
    take_ticket,
    transpose,
)
from ggavatar.jit.simd import ceil, floor, fma, lane_indices, log2, maximum, minimum, negate, select, splat, sqrt, total
from ggavatar.jit.vectors import columns_3, columns_4
from ggavatar.render.constants import MIN_ALPHA, NEAR
from ggavatar.render.cpu.harmonics import SCRATCH, colors_of, prefetch_colors
from ggavatar.render.cpu.layout import (
    CENTER,
    FOCAL,
    PRINCIPAL,
    RECORD,
    RED,
    SIZE,
    TILE,
    cloud_pointers,
    covariance,
    image_axes,
    in_gaussian_axes,
    rotation_columns,
    row,
    to_camera,
    unit_quaternion,
)

CHUNK = 1024
"""Gaussians per piece of work; fixed, so that sums over pieces do not depend on the number of threads."""

CHECKED_TENSORS = 5
"""Number of input tensors that are checked for NaN and infinity, in the order of `ggavatar.render.checks.FIELDS`."""

TILE_SIDE = np.float32(TILE)
WHITEN = np.float32(math.sqrt(0.5 * math.log2(math.e)))
"""Factor from standard deviations to u and v, so that exp(−½ d²) = 2^(−u² − v²)."""

TWO_LN2 = np.float32(2 * math.log(2))
LOG2_255 = np.float32(math.log2(255))
SLACK_PX, SLACK_REACH = np.float32(0.01), np.float32(1e-3)
"""Tolerances, in px and in log2 of alpha, by which tiles and blocks are included despite rounding."""

MAX_DETERMINANT = np.float32(1e37)
"""Gaussians whose image covariance has a larger determinant (px⁴) would overflow and are culled."""


class Footprints(NamedTuple):
    """The output of projection, rows padded to a multiple of sixteen.

    `records` [N, 16]; `means2d` [N, 2] px; `radii` [N] px; `boxes` [N, 4] tiles left, top, right, bottom (exclusive);
    `faults` [chunks, 5], not finite where an input tensor held NaN or infinity.
    """

    records: np.ndarray
    means2d: np.ndarray
    radii: np.ndarray
    boxes: np.ndarray
    faults: np.ndarray


@kernel
def project_chunks(tickets, cloud, view, footprints):
    """Kernel of one worker: project chunks of Gaussians, without colors, until none is left."""
    cloud, view, footprints = cloud_pointers(cloud), pointer(view, 0), footprint_pointers(footprints)
    chunks = (cloud.rows + CHUNK - 1) // CHUNK
    chunk = take_ticket(tickets, 0)
    while chunk < chunks:
        project_chunk(cloud, view, footprints, chunk)
        chunk = take_ticket(tickets, 0)


@kernel
def color_chunks(tickets, scratches, cloud, view, footprints):
    """Kernel of one worker: add the colors to the records of chunks of Gaussians until none is left."""
    scratch = pointer(scratches, take_ticket(tickets, 1) * SCRATCH)
    cloud, view, footprints = cloud_pointers(cloud), pointer(view, 0), footprint_pointers(footprints)
    chunks = (cloud.rows + CHUNK - 1) // CHUNK
    chunk = take_ticket(tickets, 0)
    while chunk < chunks:
        color_chunk(scratch, cloud, view, footprints, chunk)
        chunk = take_ticket(tickets, 0)


@inlined
def footprint_pointers(footprints):
    """The footprints with pointers instead of arrays."""
    records, means2d = pointer(footprints.records, 0), pointer(footprints.means2d, 0)
    radii, boxes, faults = pointer(footprints.radii, 0), pointer(footprints.boxes, 0), pointer(footprints.faults, 0)
    return Footprints(records, means2d, radii, boxes, faults)


@inlined
def project_chunk(cloud, view, footprints, chunk):
    """Project one chunk and record which inputs were not finite."""
    last = cloud.rows - 1
    zero = splat(np.float32(0))
    faults = (zero, zero, zero, zero)
    for first in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, last + 1), 16):
        faults = project_group(cloud, view, footprints, first, faults)
    offset = chunk * CHECKED_TENSORS
    footprints.faults[offset] = total(faults[0])
    footprints.faults[offset + 1] = total(faults[1])
    footprints.faults[offset + 2] = total(faults[2])
    footprints.faults[offset + 3] = total(faults[3])


@inlined
def project_group(cloud, view, footprints, first, faults):
    """Project sixteen Gaussians; returns `faults` with NaN added where an input is not finite."""
    last = cloud.rows - 1
    zero = np.float32(0)
    means, scales = columns_3(cloud.means, first, last), columns_3(cloud.scales, first, last)
    quats, opacities = columns_4(cloud.quats, first, last), gather_rows(cloud.opacities, first, last, 1, 0)
    point = to_camera(view, means)
    unit, _ = unit_quaternion(quats)
    columns = rotation_columns(unit)
    axis_0, axis_1, ratios = image_axes(view, point)
    cov = covariance(in_gaussian_axes(axis_0, columns), in_gaussian_axes(axis_1, columns), scales)
    center_x = fma(point[0] * ratios[0], view[FOCAL], view[PRINCIPAL])
    center_y = fma(point[1] * ratios[0], view[FOCAL + 1], view[PRINCIPAL + 1])
    write_group(footprints, view, (first, last), (point[2], opacities), (center_x, center_y), cov)
    return (
        fma(means[0] + means[1] + means[2], zero, faults[0]),
        fma(quats[0] + quats[1] + quats[2] + quats[3], zero, faults[1]),
        fma(scales[0] + scales[1] + scales[2], zero, faults[2]),
        fma(opacities, zero, faults[3]),
    )


@inlined
def color_chunk(scratch, cloud, view, footprints, chunk):
    """Evaluate the colors of one chunk and record whether one was not finite."""
    last = cloud.rows - 1
    fault = splat(np.float32(0))
    for first in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, last + 1), 16):
        prefetch_colors(cloud.colors, cloud.coefficients, first + 2 * 16, last)
        means = columns_3(cloud.means, first, last)
        colors, color_fault = colors_of(scratch, cloud, row(view, CENTER), means, first, last)
        for channel in range(3):
            scatter_rows(footprints.records, first, last, RECORD, RED + channel, colors[channel])
        fault = fma(color_fault, np.float32(0), fault)
    footprints.faults[chunk * CHECKED_TENSORS + 4] = total(fault)


@inlined
def write_group(footprints, view, rows, depth_opacity, center, cov):
    """Decide which of sixteen projected Gaussians are visible and write all their outputs."""
    depths, opacities = depth_opacity
    xx, xy, yy, determinant = cov
    zero, one = np.float32(0), np.float32(1)
    reach = log2(maximum(opacities, np.float32(1e-4))) + LOG2_255
    span = TWO_LN2 * maximum(reach, zero)
    half_width, half_height = sqrt(span * xx), sqrt(span * yy)
    seen = (depths > np.float32(NEAR)) & (opacities >= np.float32(MIN_ALPHA)) & (determinant < MAX_DETERMINANT)
    seen = seen & (center[0] + half_width > zero) & (center[0] - half_width < view[SIZE])
    seen = seen & (center[1] + half_height > zero) & (center[1] - half_height < view[SIZE + 1])
    store_columns(footprints.means2d, rows[0] * 2, (select(seen, center[0], zero), select(seen, center[1], zero)))
    store(footprints.radii, rows[0], select(seen, maximum(half_width, half_height), zero))
    binned = seen & (lane_indices() <= np.float32(rows[1] - rows[0]))
    left, right = covered_tiles(center[0], half_width, view[SIZE])
    top, bottom = covered_tiles(center[1], half_height, view[SIZE + 1])
    store_boxes(footprints.boxes, rows[0] * 4, (left, top, select(binned, right, left), bottom))
    root, inverse = sqrt(yy), one / sqrt(determinant)
    record = (  # xx fills the colors, which are written later, and the padding
        WHITEN * root * inverse, negate(WHITEN * xy * inverse / root), WHITEN / root,
        center[0], center[1], reach - LOG2_255,
        xx, xx, xx, depths,
        xy / xx, xy / yy, reach + SLACK_REACH, xx, xx, xx,
    )  # fmt: skip
    store_rows(footprints.records, rows[0], rows[0] + 15, RECORD, 0, transpose(record))


@inlined
def covered_tiles(center, half, size):
    """First tile, and the one after the last, whose pixel centers the interval can reach; equal if it reaches none."""
    low = maximum(ceil(center - half - (np.float32(0.5) + SLACK_PX)), np.float32(0))
    high = minimum(floor(center + half - (np.float32(0.5) - SLACK_PX)), size - np.float32(1))
    first = floor(minimum(low, size) / TILE_SIDE)
    return first, select(high >= low, floor(high / TILE_SIDE) + np.float32(1), first)
