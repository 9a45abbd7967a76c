"""The stages of the compiled rasterizer of discs: allocate, and let the threads run a kernel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

from ggavatar.jit.threads import share
from ggavatar.render.cpu.binning import Bins, count_tiles, fill_tiles, sort_by_depth
from ggavatar.render.cpu.blending import TILE, TILES_PER_TICKET
from ggavatar.render.cpu.projection import RECORD
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


class Placed(NamedTuple):
    """Discs in the lists of their tiles."""

    view: View
    records: np.ndarray
    bins: Bins
    background: np.ndarray


def place(
    size: tuple[int, int, float], depths: Tensor, radii: Tensor, background: Tensor, means2d: Tensor, colors: Tensor
) -> Placed:
    """Put discs into the lists of their tiles, front to back; `size` is width, height and radius in px."""
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
    return Placed(view, records, bins, background.numpy())


def draw(placed: Placed) -> tuple[Drawing, np.ndarray]:
    """The picture, and which discs show in it."""
    view, records, bins, background = placed
    pixels, tiles = view.width * view.height, bins.starts.size - 1
    image, light, depth = (np.empty(pixels * channels, np.float32) for channels in (3, 1, 1))
    places, counts = np.empty(pixels * NEAREST, np.int32), np.empty(pixels, np.uint8)
    drawing = Drawing(image, light, depth, places, counts, np.empty(bins.entries.size // 2, np.uint8))
    share(draw_tiles, -(-tiles // TILES_PER_TICKET), bins, records, background, view, drawing)
    shown = np.empty(bins.slots.size - 1, np.bool_)
    gather_shown(bins, drawing.shown, shown)
    return drawing, shown


def differentiate(
    placed: Placed, drawing: Drawing, to_image: np.ndarray, to_alpha: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of colors [N, 3] and image positions [N, 2]."""
    view, records, bins, background = placed
    count, tiles = bins.slots.size - 1, bins.starts.size - 1
    slots = np.empty(bins.entries.size // 2 * SLOT, np.float32)
    work = bins, records, background, view, drawing, (to_image, to_alpha), slots
    share(differentiate_tiles, -(-tiles // TILES_PER_TICKET), *work)
    to_colors, to_means2d = np.empty((count, 3), np.float32), np.empty((count, 2), np.float32)
    gather_slots(bins, slots, to_colors, to_means2d)
    return to_colors, to_means2d
