"""Compiled rasterization of discs and its gradient; every pixel stores its nearest discs as entries of its tile's list.

A tile is drawn by one thread, and every entry of a tile's list has a slot of its own for its gradient; results do not
depend on the number of threads.
"""

from __future__ import annotations

from math import ceil, floor, sqrt
from typing import Any, NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import pointer, take_ticket
from ggavatar.render.cpu.binning import bin_pointers
from ggavatar.render.cpu.blending import TILES_PER_TICKET
from ggavatar.render.cpu.layout import BLUE, DEPTH, GREEN, RECORD, RED, TILE, X, Y
from ggavatar.render.discs.values import NEAREST, SHOWN_WEIGHT

HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)
SHOWN_LIMIT = np.float32(SHOWN_WEIGHT)

TO_RED, TO_GREEN, TO_BLUE, TO_X, TO_Y, SLOT = range(6)
"""Offsets in the slot of a gradient, and its length in floats."""


class View(NamedTuple):
    """Image size in px, tiles across, and the radius of the discs in px."""

    width: int
    height: int
    tiles_x: int
    radius: np.float32


class Drawing(NamedTuple):
    """The output of the forward pass, flat.

    `image` [H·W, 3], the final `transmittance` [H·W] and `depth` [H·W]; `entries` [H·W, 10] are every pixel's discs as
    entries of the tile lists, `counts` [H·W] their number; `shown` [M] tells by slot whether a disc shows in a tile.
    """

    image: np.ndarray
    transmittance: np.ndarray
    depth: np.ndarray
    entries: np.ndarray
    counts: np.ndarray
    shown: np.ndarray


@inlined
def drawing_pointers(drawing):
    """The drawing with pointers instead of arrays."""
    image, transmittance, depth = (
        pointer(drawing.image, 0),
        pointer(drawing.transmittance, 0),
        pointer(drawing.depth, 0),
    )
    entries, counts, shown = pointer(drawing.entries, 0), pointer(drawing.counts, 0), pointer(drawing.shown, 0)
    return Drawing(image, transmittance, depth, entries, counts, shown)


@inlined
def pixel_span(center, half, size):
    """Range (last one exclusive) of the pixels of `size` whose centers lie within `half` of `center`, px."""
    low, high = ceil(center - half - HALF), floor(center + half - HALF)
    return max(np.int64(low), 0), min(np.int64(high) + 1, size)


@kernel
def place_discs(means2d, depths, radii, colors, view, records, boxes):
    """Write a record and a box of tiles (left, top, right, bottom, exclusive) for every disc."""
    for index in range(depths.size):
        offset = index * RECORD
        records[offset + X], records[offset + Y] = means2d[index, 0], means2d[index, 1]
        records[offset + DEPTH] = depths[index]
        records[offset + RED], records[offset + GREEN] = colors[index, 0], colors[index, 1]
        records[offset + BLUE] = colors[index, 2]
        boxes[4 * index : 4 * index + 4] = 0
        if radii[index] > ZERO:
            left, right = pixel_span(means2d[index, 0], view.radius, view.width)
            top, bottom = pixel_span(means2d[index, 1], view.radius, view.height)
            if right > left and bottom > top:
                boxes[4 * index], boxes[4 * index + 1] = left // TILE, top // TILE
                boxes[4 * index + 2], boxes[4 * index + 3] = (right - 1) // TILE + 1, (bottom - 1) // TILE + 1


@kernel
def draw_tiles(tickets, bins, records, background, view, drawing):
    """Kernel of one worker: draw tiles until none is left."""
    tiles = bins.starts.size - 1
    bins, records, background = bin_pointers(bins), pointer(records, 0), pointer(background, 0)
    drawing = drawing_pointers(drawing)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            find_nearest(bins, records, view, drawing, tile)
            composite(bins, records, background, view, drawing, tile)
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def tile_bounds(view, tile):
    """Left, top, right and bottom pixel (exclusive) of a tile within the image."""
    left, top = (tile % view.tiles_x) * TILE, (tile // view.tiles_x) * TILE
    return left, top, min(left + TILE, view.width), min(top + TILE, view.height)


@inlined
def find_nearest(bins, records, view, drawing, tile):
    """Store the nearest discs of every pixel of a tile."""
    left, top, right, bottom = tile_bounds(view, tile)
    for y in range(top, bottom):
        for x in range(left, right):
            drawing.counts[y * view.width + x] = 0
    open_pixels = (right - left) * (bottom - top)
    square = view.radius * view.radius
    for entry in range(bins.starts[tile], bins.starts[tile + 1]):
        drawing.shown[bins.entries[2 * entry + 1]] = 0
        if open_pixels == 0:
            continue
        record = np.int64(bins.entries[2 * entry]) * RECORD
        center_x, center_y = records[record + X], records[record + Y]
        first_y, last_y = pixel_span(center_y, view.radius, bottom)
        for y in range(max(first_y, top), last_y):
            dy = np.float32(y) + HALF - center_y
            half = np.float32(sqrt(max(square - dy * dy, ZERO)))
            first_x, last_x = pixel_span(center_x, half, right)
            for x in range(max(first_x, left), last_x):
                pixel = y * view.width + x
                count = drawing.counts[pixel]
                if count < NEAREST:
                    drawing.entries[pixel * NEAREST + count] = entry
                    drawing.counts[pixel] = count + 1
                    if count == NEAREST - 1:
                        open_pixels -= 1


@inlined
def coverage(records, record, x, y, radius):
    """Alpha of a disc in a pixel, and the pixel's offset from the disc's center, in radii."""
    dx = (np.float32(x) + HALF - records[record + X]) / radius
    dy = (np.float32(y) + HALF - records[record + Y]) / radius
    return max(ONE - (dx * dx + dy * dy), ZERO), dx, dy


@inlined
def composite(bins, records, background, view, drawing, tile):
    """Blend the discs of every pixel of a tile front to back, and mark those that show."""
    left, top, right, bottom = tile_bounds(view, tile)
    for y in range(top, bottom):
        for x in range(left, right):
            pixel = y * view.width + x
            transmittance, red, green, blue, depth = ONE, ZERO, ZERO, ZERO, ZERO
            for number in range(drawing.counts[pixel]):
                entry = np.int64(drawing.entries[pixel * NEAREST + number])
                record = np.int64(bins.entries[2 * entry]) * RECORD
                alpha, _, _ = coverage(records, record, x, y, view.radius)
                weight = alpha * transmittance
                transmittance = transmittance * (ONE - alpha)
                red += weight * records[record + RED]
                green += weight * records[record + GREEN]
                blue += weight * records[record + BLUE]
                depth += weight * records[record + DEPTH]
                if number == 0 or weight > SHOWN_LIMIT:
                    drawing.shown[bins.entries[2 * entry + 1]] = 1
            drawing.image[3 * pixel] = red + transmittance * background[0]
            drawing.image[3 * pixel + 1] = green + transmittance * background[1]
            drawing.image[3 * pixel + 2] = blue + transmittance * background[2]
            drawing.transmittance[pixel], drawing.depth[pixel] = transmittance, depth


@kernel
def gather_shown(bins, by_slot, shown):
    """Whether a disc shows in any tile."""
    for index in range(shown.size):
        seen = False
        for slot in range(bins.slots[index], bins.slots[index + 1]):
            seen = seen or by_slot[slot] != 0
        shown[index] = seen


@kernel
def differentiate_tiles(tickets, bins, records, background, view, drawing, incoming, slots):
    """Kernel of one worker: fill the slots of tiles until none is left."""
    tiles = bins.starts.size - 1
    bins, records, background = bin_pointers(bins), pointer(records, 0), pointer(background, 0)
    drawing, slots = drawing_pointers(drawing), pointer(slots, 0)
    incoming = pointer(incoming[0], 0), pointer(incoming[1], 0)
    transmittances, alphas = np.empty(NEAREST, np.float32), np.empty(NEAREST, np.float32)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            for entry in range(bins.starts[tile], bins.starts[tile + 1]):
                slot: Any = np.int64(bins.entries[2 * entry + 1]) * SLOT
                for part in range(SLOT):
                    slots[slot + part] = ZERO
            left, top, right, bottom = tile_bounds(view, tile)
            for y in range(top, bottom):
                for x in range(left, right):
                    differentiate_pixel(
                        bins, records, background, view, drawing, incoming, (x, y, transmittances, alphas), slots
                    )
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def differentiate_pixel(bins, records, background, view, drawing, incoming, work, slots):
    """Add one pixel's part to the slots of its discs, back to front.

    Let g be the pixel's gradient and B its color without a disc and those in front of it; then ∂/∂alpha = transmittance
    · ⟨g, color − B⟩, and B accumulates from back to front without a division.
    """
    to_image, to_alpha = incoming
    x, y, transmittances, alphas = work
    pixel = y * view.width + x
    count = np.int64(drawing.counts[pixel])
    transmittance = ONE
    for front in range(count):
        number: Any = np.int64(front)
        entry = np.int64(drawing.entries[pixel * NEAREST + number])
        transmittances[number] = transmittance
        alphas[number], _, _ = coverage(records, np.int64(bins.entries[2 * entry]) * RECORD, x, y, view.radius)
        transmittance = transmittance * (ONE - alphas[number])
    red, green, blue = to_image[3 * pixel], to_image[3 * pixel + 1], to_image[3 * pixel + 2]
    # The gradient of alpha acts like a fourth channel that is 1 on discs and 0 behind them.
    behind = red * background[0] + green * background[1] + blue * background[2]
    for back in range(count):
        number = np.int64(count - 1 - back)
        entry = np.int64(drawing.entries[pixel * NEAREST + number])
        record, slot = np.int64(bins.entries[2 * entry]) * RECORD, np.int64(bins.entries[2 * entry + 1]) * SLOT
        own = red * records[record + RED] + green * records[record + GREEN] + blue * records[record + BLUE]
        own = own + to_alpha[pixel]
        alpha, dx, dy = coverage(records, record, x, y, view.radius)
        weight = transmittances[number] * alpha
        d_offset = transmittances[number] * (own - behind) * (ONE + ONE) / view.radius
        slots[slot + TO_RED] += weight * red
        slots[slot + TO_GREEN] += weight * green
        slots[slot + TO_BLUE] += weight * blue
        slots[slot + TO_X] += d_offset * dx
        slots[slot + TO_Y] += d_offset * dy
        behind = alpha * own + (ONE - alpha) * behind


@kernel
def gather_slots(bins, slots, to_colors, to_means2d):
    """Sum the slots of every disc, in order of tiles."""
    for index in range(to_colors.shape[0]):
        red, green, blue, x, y = ZERO, ZERO, ZERO, ZERO, ZERO
        for slot in range(bins.slots[index], bins.slots[index + 1]):
            offset = slot * SLOT
            red, green, blue = red + slots[offset], green + slots[offset + TO_GREEN], blue + slots[offset + TO_BLUE]
            x, y = x + slots[offset + TO_X], y + slots[offset + TO_Y]
        to_colors[index, 0], to_colors[index, 1], to_colors[index, 2] = red, green, blue
        to_means2d[index, 0], to_means2d[index, 1] = x, y
