"""Projection of Gaussians, sixteen at a time: everything the tiles need, in one 64-byte record per Gaussian.

Shapes come first and colors after them, in a pass of their own: sorting into tiles needs no colors, so one thread
sorts while the others read harmonics.
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
from ggavatar.jit.simd import ceil, floor, fma, log2, maximum, minimum, negate, ramp, select, splat, sqrt, total
from ggavatar.jit.vectors import columns_3, columns_4
from ggavatar.render.constants import MIN_ALPHA, NEAR
from ggavatar.render.cpu.harmonics import SCRATCH, colors_of, prefetch_colors
from ggavatar.render.cpu.layout import (
    CENTER,
    bare_cloud,
    covariance,
    image_axes,
    rotation_columns,
    row,
    to_camera,
    turned,
    unit_quaternion,
)

# A record: whitening rows (u = XX dx + XY dy, v = YY dy, so that log2 alpha = OPACITY − u² − v²), center in px,
# log2 of the opacity, color, camera z, steps to the nearest point of the ellipse along y per dx and along x per
# dy, log2 of 255 · opacity.
XX, XY, YY, X, Y, OPACITY, RED, GREEN, BLUE, DEPTH, STEP_Y, STEP_X, REACH, RECORD = *range(13), 16

CHUNK = 1024
"""Gaussians per piece of work; fixed, so that sums over pieces do not depend on the number of threads."""

CHECKED = 5
"""Input tensors that are checked for NaN and infinity, in the order of `ggavatar.render.checks.FIELDS`."""

TILE = np.float32(16)
WHITEN = np.float32(math.sqrt(0.5 * math.log2(math.e)))
TWO_LN2 = np.float32(2 * math.log(2))
LOG2_255 = np.float32(math.log2(255))
SLACK_PX, SLACK_REACH = np.float32(0.01), np.float32(1e-3)
HUGE = np.float32(1e37)


class Footprints(NamedTuple):
    """What projection leaves, rows padded to a multiple of sixteen.

    `records` [N, 16]; `means2d` [N, 2] px; `radii` [N] px; `boxes` [N, 4] tiles left, top, right, bottom (exclusive);
    `faults` [chunks, 5], not zero where an input held NaN or infinity.
    """

    records: np.ndarray
    means2d: np.ndarray
    radii: np.ndarray
    boxes: np.ndarray
    faults: np.ndarray


@kernel
def project_chunks(tickets, cloud, view, footprints):
    """Project chunks of Gaussians, colors left out, until none is left."""
    cloud, view, footprints = bare_cloud(cloud), pointer(view, 0), bare_footprints(footprints)
    chunks = (cloud.rows + CHUNK - 1) // CHUNK
    chunk = take_ticket(tickets, 0)
    while chunk < chunks:
        project_chunk(cloud, view, footprints, chunk)
        chunk = take_ticket(tickets, 0)


@kernel
def color_chunks(tickets, scratches, cloud, view, footprints):
    """Add the colors to the records of chunks of Gaussians until none is left."""
    scratch = pointer(scratches, take_ticket(tickets, 1) * SCRATCH)
    cloud, view, footprints = bare_cloud(cloud), pointer(view, 0), bare_footprints(footprints)
    chunks = (cloud.rows + CHUNK - 1) // CHUNK
    chunk = take_ticket(tickets, 0)
    while chunk < chunks:
        color_chunk(scratch, cloud, view, footprints, chunk)
        chunk = take_ticket(tickets, 0)


@inlined
def bare_footprints(footprints):
    """The footprints with pointers instead of arrays."""
    records, means2d, radii = (
        pointer(footprints.records, 0),
        pointer(footprints.means2d, 0),
        pointer(footprints.radii, 0),
    )
    return Footprints(records, means2d, radii, pointer(footprints.boxes, 0), pointer(footprints.faults, 0))


@inlined
def project_chunk(cloud, view, footprints, chunk):
    """Project one chunk and note which inputs were not finite."""
    last = cloud.rows - 1
    zero = splat(np.float32(0))
    faults = (zero, zero, zero, zero)
    for first in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, last + 1), 16):
        faults = project_group(cloud, view, footprints, first, faults)
    place = chunk * CHECKED
    footprints.faults[place] = total(faults[0])
    footprints.faults[place + 1] = total(faults[1])
    footprints.faults[place + 2] = total(faults[2])
    footprints.faults[place + 3] = total(faults[3])


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
    cov = covariance(turned(axis_0, columns), turned(axis_1, columns), scales)
    center = (fma(point[0] * ratios[0], view[12], view[14]), fma(point[1] * ratios[0], view[13], view[15]))
    write_group(footprints, view, (first, last), (point[2], opacities), center, cov)
    return (
        fma(means[0] + means[1] + means[2], zero, faults[0]),
        fma(quats[0] + quats[1] + quats[2] + quats[3], zero, faults[1]),
        fma(scales[0] + scales[1] + scales[2], zero, faults[2]),
        fma(opacities, zero, faults[3]),
    )


@inlined
def color_chunk(scratch, cloud, view, footprints, chunk):
    """Color one chunk and note whether a color was not finite."""
    last = cloud.rows - 1
    fault = splat(np.float32(0))
    for first in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, last + 1), 16):
        prefetch_colors(cloud.colors, cloud.coefficients, first + 2 * 16, last)
        means = columns_3(cloud.means, first, last)
        colors, color_fault = colors_of(scratch, cloud, row(view, CENTER), means, first, last)
        for channel in range(3):
            scatter_rows(footprints.records, first, last, RECORD, RED + channel, colors[channel])
        fault = fma(color_fault, np.float32(0), fault)
    footprints.faults[chunk * CHECKED + 4] = total(fault)


@inlined
def write_group(footprints, view, rows, depth_opacity, center, cov):
    """Decide which of sixteen projected Gaussians are visible and write all their outputs."""
    depths, opacities = depth_opacity
    xx, xy, yy, determinant = cov
    zero, one = np.float32(0), np.float32(1)
    reach = log2(maximum(opacities, np.float32(1e-4))) + LOG2_255
    span = TWO_LN2 * maximum(reach, zero)
    half_width, half_height = sqrt(span * xx), sqrt(span * yy)
    seen = (depths > np.float32(NEAR)) & (opacities >= np.float32(MIN_ALPHA)) & (determinant < HUGE)
    seen = seen & (center[0] + half_width > zero) & (center[0] - half_width < view[23])
    seen = seen & (center[1] + half_height > zero) & (center[1] - half_height < view[24])
    store_columns(footprints.means2d, rows[0] * 2, (select(seen, center[0], zero), select(seen, center[1], zero)))
    store(footprints.radii, rows[0], select(seen, maximum(half_width, half_height), zero))
    drawn = seen & (ramp() <= np.float32(rows[1] - rows[0]))
    left, right = covered_tiles(center[0], half_width, view[23])
    top, bottom = covered_tiles(center[1], half_height, view[24])
    store_boxes(footprints.boxes, rows[0] * 4, (left, top, select(drawn, right, left), bottom))
    root, inverse = sqrt(yy), one / sqrt(determinant)
    record = (  # colors, like the padding, are for now whatever is at hand
        WHITEN * root * inverse, negate(WHITEN * xy * inverse / root), WHITEN / root,
        center[0], center[1], reach - LOG2_255,
        xx, xx, xx, depths,
        xy / xx, xy / yy, reach + SLACK_REACH, xx, xx, xx,
    )  # fmt: skip
    store_rows(footprints.records, rows[0], rows[0] + 15, RECORD, 0, transpose(record))


@inlined
def covered_tiles(center, half, size):
    """First tile and one past the last tile whose pixel centers the interval can reach; equal where it reaches none."""
    low = maximum(ceil(center - half - (np.float32(0.5) + SLACK_PX)), np.float32(0))
    high = minimum(floor(center + half - (np.float32(0.5) - SLACK_PX)), size - np.float32(1))
    first = floor(minimum(low, size) / TILE)
    return first, select(high >= low, floor(high / TILE) + np.float32(1), first)
