"""Lookup in a hash tri-plane and its gradient in Triton (torch twin: `fields.lookup_in_torch`).

One program looks up a block of points in all tables of a plane. The gradient is added atomically, in any order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import triton.language as tl
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.jit.triton_kernels import device_function, device_kernel

PLANES, FEATURES, PRIME = tl.constexpr(3), tl.constexpr(2), tl.constexpr(2654435761)
BLOCK = 128


class DeviceLayout(NamedTuple):
    """Geometry of the tables on the device, one element per table (see `triplane_kernel.Layout`)."""

    scale: Tensor
    side: Tensor
    mask: Tensor
    first: Tensor


class Cube(NamedTuple):
    """The cube in which positions are normalized: its center and its edge, m."""

    x: float
    y: float
    z: float
    edge: float


def device_layout(layout: Any, device: torch.device) -> DeviceLayout:
    """A `triplane_kernel.Layout` on a device."""
    whole = (torch.from_numpy(part.astype("int32")) for part in (layout.side, layout.mask, layout.first))
    return DeviceLayout(torch.from_numpy(layout.scale).to(device), *(part.to(device) for part in whole))


@device_function
def _place(x, n, alive, plane, center_x, center_y, center_z, edge):
    """The two coordinates of points on a plane, in [0, 1]; NaN becomes 0, so that it is a valid index."""
    first, second = tl.where(plane == 2, 1, 0), tl.where(plane == 0, 1, 2)
    center_0, center_1 = tl.where(plane == 2, center_y, center_x), tl.where(plane == 0, center_y, center_z)
    across = (tl.load(x + 3 * n + first, mask=alive, other=0.0) - center_0) / edge + 0.5
    down = (tl.load(x + 3 * n + second, mask=alive, other=0.0) - center_1) / edge + 0.5
    across, down = tl.where(across > 0, across, 0.0), tl.where(down > 0, down, 0.0)
    return tl.minimum(across, 1.0), tl.minimum(down, 1.0)


@device_function
def _cell(across, down, scales, table):
    """The cell of a table that points are in, and where they are in it."""
    scale = tl.load(scales + table)
    x, y = across * scale + 0.5, down * scale + 0.5
    column, row = x.to(tl.int32), y.to(tl.int32)  # positions are not negative, so this is the floor
    return column, row, x - column.to(tl.float32), y - row.to(tl.float32)


@device_function
def _corner(cell, CORNER: tl.constexpr, side, mask, first):
    """Entry and bilinear weight of one of the four grid vertices around points; `mask` is 0 for dense tables."""
    column, row, u, v = cell
    left, top = (column + (CORNER % 2)).to(tl.uint32), (row + (CORNER // 2)).to(tl.uint32)
    hashed = ((left ^ (top * PRIME)) & mask).to(tl.int64)
    entry = first + tl.where(mask != 0, hashed, left.to(tl.int64) + top.to(tl.int64) * side)
    return entry, (u if CORNER % 2 == 1 else 1 - u) * (v if CORNER // 2 == 1 else 1 - v)


@device_kernel
def look_up_points(
    x, tables, scales, sides, masks, firsts, features,
    rows, center_x, center_y, center_z, edge,
    LEVELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the features [N, 3 · LEVELS · 2] of positions [N, 3]; program 3 i + p: block i in plane p."""
    n, plane = (tl.program_id(0) // PLANES) * BLOCK + tl.arange(0, BLOCK), tl.program_id(0) % PLANES
    alive = n < rows
    across, down = _place(x, n, alive, plane, center_x, center_y, center_z, edge)
    for level in range(LEVELS):
        table = plane * LEVELS + level
        side, mask, first = tl.load(sides + table), tl.load(masks + table), tl.load(firsts + table)
        cell = _cell(across, down, scales, table)
        feature_0, feature_1 = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
        for corner in tl.static_range(4):
            entry, weight = _corner(cell, corner, side, mask, first)
            feature_0 += weight * tl.load(tables + FEATURES * entry, mask=alive, other=0.0)
            feature_1 += weight * tl.load(tables + FEATURES * entry + 1, mask=alive, other=0.0)
        at = features + n.to(tl.int64) * (PLANES * LEVELS * FEATURES) + table * FEATURES
        tl.store(at, feature_0, mask=alive)
        tl.store(at + 1, feature_1, mask=alive)


@device_kernel
def spread_gradient(
    x, upstream, scales, sides, masks, firsts, gradient,
    rows, center_x, center_y, center_z, edge,
    LEVELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add the gradient of features to that of the tables [T, 2]; points without gradient cost nothing."""
    n, plane = (tl.program_id(0) // PLANES) * BLOCK + tl.arange(0, BLOCK), tl.program_id(0) % PLANES
    alive = n < rows
    across, down = _place(x, n, alive, plane, center_x, center_y, center_z, edge)
    for level in range(LEVELS):
        table = plane * LEVELS + level
        side, mask, first = tl.load(sides + table), tl.load(masks + table), tl.load(firsts + table)
        at = upstream + n.to(tl.int64) * (PLANES * LEVELS * FEATURES) + table * FEATURES
        given_0, given_1 = tl.load(at, mask=alive, other=0.0), tl.load(at + 1, mask=alive, other=0.0)
        wanted = alive & ((given_0 != 0) | (given_1 != 0))
        cell = _cell(across, down, scales, table)
        for corner in tl.static_range(4):
            entry, weight = _corner(cell, corner, side, mask, first)
            into = gradient + FEATURES * entry
            tl.atomic_add(into, weight * given_0, mask=wanted, sem="relaxed")
            tl.atomic_add(into + 1, weight * given_1, mask=wanted, sem="relaxed")


def look_up(x: Tensor, cube: Cube, tables: Tensor, layout: DeviceLayout) -> Tensor:
    """Features of positions (m)."""
    rows, kinds = len(x), len(layout.scale)
    features = torch.empty(rows, kinds * FEATURES.value, device=x.device)
    _launch(look_up_points, x, tables, layout, features, cube)
    return features


def backward(x: Tensor, cube: Cube, upstream: Tensor, layout: DeviceLayout, tables: Tensor) -> Tensor:
    """Gradient of the tables."""
    gradient = torch.zeros_like(tables)
    _launch(spread_gradient, x, upstream, layout, gradient, cube)
    return gradient


def _launch(kernel: Any, x: Tensor, source: Tensor, layout: DeviceLayout, target: Tensor, cube: Cube) -> None:
    programs, levels = -(-len(x) // BLOCK) * PLANES.value, len(layout.scale) // PLANES.value
    device_kernels.launch(kernel, programs, x, source, *layout, target, len(x), *cube, LEVELS=levels, BLOCK=BLOCK)
