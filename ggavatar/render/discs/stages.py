"""The stages of the compiled rasterizer of discs; each allocates memory and runs a kernel on all threads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

from ggavatar.jit.threads import run_workers
from ggavatar.render.cpu.binning import Bins, count_tiles, fill_tiles, sort_by_depth
from ggavatar.render.cpu.blending import TILES_PER_TICKET
from ggavatar.render.cpu.layout import RECORD, TILE
from ggavatar.render.discs.kernel import (
    SLOT,
    Drawing,
    View,
    differentiate_tiles,
    draw_tiles,
    gather_shown,
    gather_slots,
    place_discs,
)
from ggavatar.render.discs.values import NEAREST


class BinnedDiscs(NamedTuple):
    """Discs, sorted by depth into lists per tile."""

    view: View
    records: np.ndarray
    bins: Bins
    background: np.ndarray


def bin_discs(
    size: tuple[int, int, float], depths: Tensor, radii: Tensor, background: Tensor, means2d: Tensor, colors: Tensor
) -> BinnedDiscs:
    """Sort discs into tiles, front to back; `size` is the image's width and height and the discs' radius, px."""
    width, height, radius = size
    view = View(width, height, -(-width // TILE), np.float32(radius))
    count, tiles = len(depths), view.tiles_x * -(-height // TILE)
    records, boxes = np.empty(count * RECORD, np.float32), np.empty(4 * count, np.int16)
    arrays = [tensor.detach().contiguous().numpy() for tensor in (means2d, depths, radii, colors)]
    place_discs(*arrays, view, records, boxes)
    starts, slots = np.empty(tiles + 1, np.int64), np.empty(count + 1, np.int64)
    seen = count_tiles(boxes, view.tiles_x, starts, slots)
    order = sort_by_depth(records, slots, np.empty(seen, np.int64), np.empty(seen, np.int64))
    bins = Bins(starts, np.empty(2 * starts[-1], np.int32), slots)
    fill_tiles(order, boxes, view.tiles_x, bins)
    return BinnedDiscs(view, records, bins, background.numpy())


def draw(discs: BinnedDiscs) -> tuple[Drawing, np.ndarray]:
    """Draw all tiles; also returns which discs show."""
    view, records, bins, background = discs
    pixels, tiles = view.width * view.height, bins.starts.size - 1
    image, transmittance, depth = (np.empty(pixels * channels, np.float32) for channels in (3, 1, 1))
    entries, counts = np.empty(pixels * NEAREST, np.int32), np.empty(pixels, np.uint8)
    drawing = Drawing(image, transmittance, depth, entries, counts, np.empty(bins.entries.size // 2, np.uint8))
    run_workers(draw_tiles, -(-tiles // TILES_PER_TICKET), bins, records, background, view, drawing)
    shown = np.empty(bins.slots.size - 1, np.bool_)
    gather_shown(bins, drawing.shown, shown)
    return drawing, shown


def differentiate(
    discs: BinnedDiscs, drawing: Drawing, to_image: np.ndarray, to_alpha: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of colors [N, 3] and projected centers [N, 2], from those of image and alpha."""
    view, records, bins, background = discs
    count, tiles = bins.slots.size - 1, bins.starts.size - 1
    slots = np.empty(bins.entries.size // 2 * SLOT, np.float32)
    work = bins, records, background, view, drawing, (to_image, to_alpha), slots
    run_workers(differentiate_tiles, -(-tiles // TILES_PER_TICKET), *work)
    to_colors, to_means2d = np.empty((count, 3), np.float32), np.empty((count, 2), np.float32)
    gather_slots(bins, slots, to_colors, to_means2d)
    return to_colors, to_means2d
