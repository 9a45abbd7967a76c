"""Projection of a block of Gaussians into one record each, and which tiles they touch."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import load_3, load_4, product
from ggavatar.render.triton.geometry import (
    axis_view,
    camera_center,
    camera_rotation,
    camera_translation,
    covariance,
    image_axis,
    onto_rows,
    rotation_columns,
    unit_quaternion,
    whitening,
)
from ggavatar.render.triton.harmonics import colors_of, direction
from ggavatar.render.triton.layout import (
    BLUE,
    DEPTH,
    FAULTS,
    GREEN,
    LARGEST,
    LOG2_255,
    LOG_OPACITY,
    MAX_DETERMINANT,
    MIN_ALPHA,
    NEAR,
    RECORD,
    RED,
    SLACK_PX,
    TILE,
    TWO_LN2,
    WHITEN,
    WHITEN_XX,
    WHITEN_XY,
    WHITEN_YY,
    X,
    Y,
)


@device_kernel
def project_gaussians(
    means, quats, scales, opacities, colors, pose, intrinsics, background,
    records, means2d, radii, depths, boxes, counts, status,
    rows, width, height,
    HELD: tl.constexpr, DEGREE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Project Gaussians; one program takes a block of rows.

    Reads the Gaussians, the pose [4, 4], intrinsics [3, 3] and background [3]. Writes records [N, RECORD], means2d
    [N, 2] and radii [N] in px (0 for invisible ones), depths [N] (infinite for those in no tile), boxes [N, 4] of tiles
    left, top, width, height, their counts [N], and bits in the status for inputs that are not finite. `HELD` is the
    number of harmonics per channel, 0 for RGB.
    """
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    mean, quat, scale = load_3(means, row, alive), load_4(quats, row, alive), load_3(scales, row, alive)
    opacity = tl.load(opacities + row, mask=alive, other=0.0)
    rotation, translation = camera_rotation(pose), camera_translation(pose)
    x, y, depth = onto_rows(rotation, mean)
    x, y, depth = x + translation[0], y + translation[1], depth + translation[2]
    inverse = 1.0 / depth
    view_x, view_y = axis_view(intrinsics, 0, width), axis_view(intrinsics, 1, height)
    axis_0, _ = image_axis(rotation[0], rotation[2], x, inverse, view_x)
    axis_1, _ = image_axis(rotation[1], rotation[2], y, inverse, view_y)
    unit, _ = unit_quaternion(quat)
    columns = rotation_columns(unit)
    spread_0, spread_1 = product(onto_rows(columns, axis_0), scale), product(onto_rows(columns, axis_1), scale)
    xx, xy, yy, determinant = covariance(spread_0, spread_1)
    center_x, center_y = x * inverse * view_x[0] + view_x[1], y * inverse * view_y[0] + view_y[1]
    log_opacity = tl.log2(tl.maximum(opacity, 1e-4))
    span = TWO_LN2 * tl.maximum(log_opacity + LOG2_255, 0.0)
    half_x, half_y = tl.sqrt(span * xx), tl.sqrt(span * yy)
    seen = alive & (depth > NEAR) & (opacity >= MIN_ALPHA) & (determinant < MAX_DETERMINANT)
    seen = seen & (center_x + half_x > 0) & (center_x - half_x < width)
    seen = seen & (center_y + half_y > 0) & (center_y - half_y < height)
    left, across = covered_tiles(center_x, half_x, width, seen)
    top, down = covered_tiles(center_y, half_y, height, seen)
    _store_places(means2d, radii, boxes, counts, depths, row, alive, (
        tl.where(seen, center_x, 0.0), tl.where(seen, center_y, 0.0), tl.where(seen, tl.maximum(half_x, half_y), 0.0),
        left, top, across, down, depth,
    ))  # fmt: skip

    if HELD == 0:
        red, green, blue = load_3(colors, row, alive)
        color_fault = ~is_finite(red + green + blue)
    else:
        towards, _ = direction(mean, camera_center(rotation, translation))
        red, green, blue = colors_of(colors, row, alive, towards, HELD, DEGREE)
        color_fault = is_finite(towards[0] + towards[1] + towards[2]) & ~is_finite(red + green + blue)
    a, b, c = whitening(xx, xy, yy, determinant)
    at = records + row * RECORD
    tl.store(at + WHITEN_XX, tl.where(seen, WHITEN * a, 0.0), mask=alive)
    tl.store(at + WHITEN_XY, tl.where(seen, WHITEN * b, 0.0), mask=alive)
    tl.store(at + WHITEN_YY, tl.where(seen, WHITEN * c, 0.0), mask=alive)
    tl.store(at + X, tl.where(seen, center_x, 0.0), mask=alive)
    tl.store(at + Y, tl.where(seen, center_y, 0.0), mask=alive)
    tl.store(at + LOG_OPACITY, tl.where(seen, log_opacity, -1e3), mask=alive)
    floor = -LARGEST if HELD == 0 else 0.0
    tl.store(at + RED, tl.where(seen, tl.maximum(red, floor), 0.0), mask=alive)
    tl.store(at + GREEN, tl.where(seen, tl.maximum(green, floor), 0.0), mask=alive)
    tl.store(at + BLUE, tl.where(seen, tl.maximum(blue, floor), 0.0), mask=alive)
    tl.store(at + DEPTH, tl.where(seen, depth, 0.0), mask=alive)
    _report_faults(status, alive, mean, quat, scale, opacity, color_fault)
    if tl.program_id(0) == 0:
        report_view_faults(status, pose, intrinsics, background)


@device_function
def covered_tiles(center, half, size, seen):
    """First tile whose pixel centers the interval can reach, and how many tiles it reaches."""
    low = tl.maximum(tl.ceil(center - half - (0.5 + SLACK_PX)), 0.0)
    high = tl.minimum(tl.floor(center + half - (0.5 - SLACK_PX)), size - 1.0)
    reaches = seen & (high >= low)
    first = tl.where(reaches, low, 0.0).to(tl.int32) // TILE
    last = tl.where(reaches, high, 0.0).to(tl.int32) // TILE
    return first, tl.where(reaches, last - first + 1, 0)


@device_function
def _store_places(means2d, radii, boxes, counts, depths, row, alive, place):
    """Write where Gaussians are in the image."""
    x, y, radius, left, top, across, down, depth = place
    tl.store(means2d + 2 * row, x, mask=alive)
    tl.store(means2d + 2 * row + 1, y, mask=alive)
    tl.store(radii + row, radius, mask=alive)
    tl.store(boxes + 4 * row, left, mask=alive)
    tl.store(boxes + 4 * row + 1, top, mask=alive)
    tl.store(boxes + 4 * row + 2, across, mask=alive)
    tl.store(boxes + 4 * row + 3, down, mask=alive)
    tl.store(counts + row, across * down, mask=alive)
    tl.store(depths + row, tl.where(across * down > 0, depth, float("inf")), mask=alive)


@device_function
def is_finite(value):
    """Whether numbers are neither NaN nor infinite."""
    return tl.abs(value) <= LARGEST


@device_function
def _report_faults(status, alive, mean, quat, scale, opacity, color_fault):
    """Set the bits of the tensors, in the order of `ggavatar.render.checks.FIELDS`, that hold NaN or infinity."""
    bits = tl.where(is_finite(mean[0]) & is_finite(mean[1]) & is_finite(mean[2]), 0, 1)
    bits |= tl.where(is_finite(quat[0]) & is_finite(quat[1]) & is_finite(quat[2]) & is_finite(quat[3]), 0, 2)
    bits |= tl.where(is_finite(scale[0]) & is_finite(scale[1]) & is_finite(scale[2]), 0, 4)
    bits |= tl.where(is_finite(opacity), 0, 8) | tl.where(color_fault, 16, 0)
    if tl.max(tl.where(alive, bits, 0), axis=0) > 0:
        tl.atomic_or(status + FAULTS + tl.zeros_like(bits), bits, mask=alive & (bits > 0), sem="relaxed")


@device_function
def report_view_faults(status, pose, intrinsics, background):
    """Set the bits of the view's tensors, in the order of `ggavatar.render.checks.VIEW_NAMES`, after those above."""
    k = tl.arange(0, 16)
    bits = tl.where(is_finite(tl.load(intrinsics + k, mask=k < 9, other=0.0)), 0, 32)
    bits |= tl.where(is_finite(tl.load(pose + k)), 0, 64)
    bits |= tl.where(is_finite(tl.load(background + k, mask=k < 3, other=0.0)), 0, 128)
    if tl.max(bits, axis=0) > 0:
        tl.atomic_or(status + FAULTS + tl.zeros_like(bits), bits, mask=bits > 0, sem="relaxed")
