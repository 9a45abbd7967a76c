"""The stages of the rasterizer: each allocates memory and launches kernels; none waits for the device."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.render.triton import drawing, gradient, pairs, projection, tile_gradient
from ggavatar.render.triton.layout import POSE_SUMS, RECORD, STATUS, SUMS, TILE

BLOCK = 128
"""Gaussians, pairs or numbers a program."""

NARROW_TILES = 32_767
"""With up to this many tiles, their numbers are sorted as 16-bit integers, which takes half the passes."""


class View(NamedTuple):
    """A camera and a background as the kernels read them, and the sizes of the image in px and of harmonics.

    `held` is the number of harmonics per channel, 0 for RGB, and `degree` the highest one to evaluate.
    """

    pose: Tensor
    intrinsics: Tensor
    background: Tensor
    width: int
    height: int
    held: int
    degree: int


class Placed(NamedTuple):
    """Depths [N] of Gaussians, infinite for those in no tile, their boxes [N, 4] of tiles and the boxes' sizes [N]."""

    depths: Tensor
    boxes: Tensor
    counts: Tensor


class Footprints(NamedTuple):
    """The output of projection (`ggavatar.render.triton.projection`): records, radii, and where they are."""

    records: Tensor
    radii: Tensor
    placed: Placed


class Lists(NamedTuple):
    """Pairs of Gaussian and tile, in order of tiles and then of depth.

    `order` [N] are the Gaussians by depth and `ends` [N] their cumulated counts; `places` [capacity] is where a pair
    was before it was sorted by tile, `entries` [capacity] its Gaussian; `starts` [tiles + 1].
    """

    order: Tensor
    ends: Tensor
    places: Tensor
    entries: Tensor
    starts: Tensor


class Canvas(NamedTuple):
    """Image [H, W, 3], alpha and depth [H, W, 1], and the transmittance behind the last Gaussian."""

    image: Tensor
    alpha: Tensor
    depth: Tensor
    light: Tensor


def tiles_of(width: int, height: int) -> tuple[int, int]:
    """Tiles across and down."""
    return -(-width // TILE.value), -(-height // TILE.value)


def project(view: View, cloud: tuple[Tensor, ...], means2d: Tensor) -> tuple[Footprints, Tensor]:
    """Project Gaussians (means, quats, scales, opacities, colors); also writes `means2d`, and returns the status."""
    rows, device = len(means2d), means2d.device
    floats: dict[str, Any] = {"device": device, "dtype": torch.float32}
    numbers: dict[str, Any] = {"device": device, "dtype": torch.int32}
    records = torch.empty(rows, RECORD.value, **floats)
    radii, depths = torch.empty(rows, **floats), torch.empty(rows, **floats)
    boxes, counts = torch.empty(rows, 4, **numbers), torch.empty(rows, **numbers)
    status = torch.zeros(STATUS.value, **numbers)
    device_kernels.launch(
        projection.project_gaussians, -(-rows // BLOCK), *cloud, view.pose, view.intrinsics, view.background,
        records, means2d, radii, depths, boxes, counts, status, rows, view.width, view.height,
        HELD=view.held, DEGREE=view.degree, BLOCK=BLOCK,
    )  # fmt: skip
    return Footprints(records, radii, Placed(depths, boxes, counts)), status


def list_pairs(size: tuple[int, int], placed: Placed, capacity: int, status: Tensor) -> Lists:
    """Sort Gaussians into the lists of the tiles across and down; pairs beyond the capacity are not listed."""
    rows, device = len(placed.counts), status.device
    across, tiles = size[0], size[0] * size[1]
    order = torch.sort(placed.depths, stable=True).indices
    ends = placed.counts.index_select(0, order).cumsum(0)
    kind = torch.int16 if tiles <= NARROW_TILES else torch.int32
    pair_tiles = torch.empty(capacity, dtype=kind, device=device)
    pair_rows, entries = (torch.empty(capacity, dtype=torch.int32, device=device) for _ in range(2))
    device_kernels.launch(
        pairs.list_pairs, -(-capacity // BLOCK), order, ends, placed.boxes, pair_tiles, pair_rows, status,
        rows, across, tiles, capacity, rows.bit_length(), BLOCK=BLOCK,
    )  # fmt: skip
    sorted_tiles, places = torch.sort(pair_tiles, stable=True)
    starts = torch.empty(tiles + 1, dtype=torch.int32, device=device)
    device_kernels.launch(
        pairs.finish_lists, -(-max(capacity, tiles + 1) // BLOCK), sorted_tiles, places, pair_rows, entries, starts,
        capacity, tiles, capacity.bit_length(), BLOCK=BLOCK,
    )  # fmt: skip
    return Lists(order, ends, places, entries, starts)


def draw(view: View, records: Tensor, lists: Lists) -> Canvas:
    """Draw all tiles."""
    canvas = new_canvas(view.width, view.height, records.device)
    across, down = tiles_of(view.width, view.height)
    device_kernels.launch(
        drawing.draw_tiles, across * down, records, lists.entries, lists.order, lists.starts, lists.ends,
        view.background, *canvas,
        len(records), len(lists.entries), view.width, view.height, across, warps=8,
    )  # fmt: skip
    return canvas


def new_canvas(width: int, height: int, device: torch.device) -> Canvas:
    """An uninitialized canvas."""
    return Canvas(*(torch.empty(height, width, channels, device=device) for channels in (3, 1, 1, 1)))


def differentiate_tiles(
    view: View,
    records: Tensor,
    lists: Lists,
    canvas: Canvas,
    upstream: tuple[Tensor | None, Tensor | None, Tensor | None],
) -> Tensor:
    """Sums [capacity, SUMS] over pixels, from the gradients of image, alpha and depth."""
    rows, capacity = len(records), len(lists.entries)
    sums = records.new_empty(capacity, SUMS.value)
    sums[:rows].zero_()  # what is added to, should the pairs have overflowed
    given = [canvas.light if gradient is None else gradient for gradient in upstream]
    has = {f"HAS_{name}": upstream[number] is not None for number, name in enumerate(("IMAGE", "ALPHA", "DEPTH"))}
    across, down = tiles_of(view.width, view.height)
    device_kernels.launch(
        tile_gradient.differentiate_tiles, across * down, records, lists.entries, lists.order, lists.places,
        lists.starts, lists.ends, canvas.image, canvas.depth, canvas.light, *given, sums,
        rows, capacity, view.width, view.height, across,
        **has, warps=8,
    )  # fmt: skip
    return sums


def differentiate_gaussians(
    view: View, cloud: tuple[Tensor, ...], footprints: Footprints, lists: Lists, sums: Tensor
) -> tuple[list[Tensor], Tensor, Tensor]:
    """Gradients of the Gaussians' tensors, of the projected centers, and of the pose."""
    rows, programs = len(footprints.placed.counts), -(-len(footprints.placed.counts) // BLOCK)
    gradients = [torch.empty_like(tensor) for tensor in cloud]
    to_means2d, to_pose = sums.new_empty(rows, 2), torch.empty_like(view.pose)
    to_poses = sums.new_empty(programs, POSE_SUMS.value)
    device_kernels.launch(
        gradient.differentiate_gaussians, programs, *cloud, view.pose, view.intrinsics,
        footprints.records, lists.order, lists.ends, footprints.placed.counts, footprints.radii, sums,
        *gradients, to_means2d, to_poses, rows, len(lists.entries), view.width, view.height,
        HELD=view.held, DEGREE=view.degree, BLOCK=BLOCK,
    )  # fmt: skip
    device_kernels.launch(gradient.finish_pose, 1, to_poses, view.pose, to_pose, programs, BLOCK=64)
    return gradients, to_means2d, to_pose
