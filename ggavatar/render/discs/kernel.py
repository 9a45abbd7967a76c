"""Compiled drawing of discs and its gradient: every pixel keeps the places of its nearest discs in its tile's list.

A tile is drawn by one thread, and every entry of a tile's list has a slot of its own for its gradient; results do
not depend on the number of threads.
"""

from __future__ import annotations

from math import ceil, floor, sqrt
from typing import Any, NamedTuple

import numpy as np

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import pointer, take_ticket
from ggavatar.render.cpu.binning import bare_bins
from ggavatar.render.cpu.blending import TILE, TILES_PER_TICKET
from ggavatar.render.cpu.projection import BLUE, DEPTH, GREEN, RECORD, RED, X, Y
from ggavatar.render.discs.values import NEAREST, SHOWN_WEIGHT

PIXELS = TILE * TILE
HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)
MUCH = np.float32(SHOWN_WEIGHT)

TO_RED, TO_GREEN, TO_BLUE, TO_X, TO_Y, SLOT = range(6)
"""Places in the slot of a gradient, and their number."""


class View(NamedTuple):
    """Image size in px, tiles across, and the radius of the discs in px."""

    width: int
    height: int
    tiles_x: int
    radius: np.float32


class Drawing(NamedTuple):
    """What is drawn.

    `image` [H·W, 3], `light` [H·W] the transmittance that is left, `depth` [H·W]; `places` [H·W, 10] the discs of
    every pixel as places in its tile's list, `counts` [H·W] how many; `shown` by slot.
    """

    image: np.ndarray
    light: np.ndarray
    depth: np.ndarray
    places: np.ndarray
    counts: np.ndarray
    shown: np.ndarray


@inlined
def bare_drawing(drawing):
    """The drawing with pointers instead of arrays."""
    image, light, depth = pointer(drawing.image, 0), pointer(drawing.light, 0), pointer(drawing.depth, 0)
    places, counts, shown = pointer(drawing.places, 0), pointer(drawing.counts, 0), pointer(drawing.shown, 0)
    return Drawing(image, light, depth, places, counts, shown)


@inlined
def span(center, half, size):
    """First pixel, and first pixel beyond, of those in [0, size) whose centers lie within `half` of `center`, px."""
    low, high = ceil(center - half - HALF), floor(center + half - HALF)
    return max(np.int64(low), 0), min(np.int64(high) + 1, size)


@kernel
def place_discs(means2d, depths, radii, colors, view, records, boxes):
    """One record and one box of tiles (left, top, right, bottom, exclusive) for every disc."""
    for index in range(depths.size):
        place = index * RECORD
        records[place + X], records[place + Y] = means2d[index, 0], means2d[index, 1]
        records[place + DEPTH] = depths[index]
        records[place + RED], records[place + GREEN] = colors[index, 0], colors[index, 1]
        records[place + BLUE] = colors[index, 2]
        boxes[4 * index : 4 * index + 4] = 0
        if radii[index] > ZERO:
            left, right = span(means2d[index, 0], view.radius, view.width)
            top, bottom = span(means2d[index, 1], view.radius, view.height)
            if right > left and bottom > top:
                boxes[4 * index], boxes[4 * index + 1] = left // TILE, top // TILE
                boxes[4 * index + 2], boxes[4 * index + 3] = (right - 1) // TILE + 1, (bottom - 1) // TILE + 1


@kernel
def draw_tiles(tickets, bins, records, background, view, drawing):
    """Draw tiles until none is left."""
    tiles = bins.starts.size - 1
    bins, records, background = bare_bins(bins), pointer(records, 0), pointer(background, 0)
    drawing = bare_drawing(drawing)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            find_nearest(bins, records, view, drawing, tile)
            composite(bins, records, background, view, drawing, tile)
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def corner(view, tile):
    """Left, top, right and bottom pixel (exclusive) of a tile within the image."""
    left, top = (tile % view.tiles_x) * TILE, (tile // view.tiles_x) * TILE
    return left, top, min(left + TILE, view.width), min(top + TILE, view.height)


@inlined
def find_nearest(bins, records, view, drawing, tile):
    """Note the nearest discs of every pixel of a tile."""
    left, top, right, bottom = corner(view, tile)
    for y in range(top, bottom):
        for x in range(left, right):
            drawing.counts[y * view.width + x] = 0
    open_pixels = (right - left) * (bottom - top)
    square = view.radius * view.radius
    for place in range(bins.starts[tile], bins.starts[tile + 1]):
        drawing.shown[bins.entries[2 * place + 1]] = 0
        if open_pixels == 0:
            continue
        record = np.int64(bins.entries[2 * place]) * RECORD
        center_x, center_y = records[record + X], records[record + Y]
        first_y, last_y = span(center_y, view.radius, bottom)
        for y in range(max(first_y, top), last_y):
            dy = np.float32(y) + HALF - center_y
            half = np.float32(sqrt(max(square - dy * dy, ZERO)))
            first_x, last_x = span(center_x, half, right)
            for x in range(max(first_x, left), last_x):
                pixel = y * view.width + x
                count = drawing.counts[pixel]
                if count < NEAREST:
                    drawing.places[pixel * NEAREST + count] = place
                    drawing.counts[pixel] = count + 1
                    if count == NEAREST - 1:
                        open_pixels -= 1


@inlined
def coverage(records, record, x, y, radius):
    """Alpha of a disc in a pixel, and the offset of the pixel from its center in radii."""
    dx = (np.float32(x) + HALF - records[record + X]) / radius
    dy = (np.float32(y) + HALF - records[record + Y]) / radius
    return max(ONE - (dx * dx + dy * dy), ZERO), dx, dy


@inlined
def composite(bins, records, background, view, drawing, tile):
    """Blend the discs of every pixel of a tile front to back, and note which of them show."""
    left, top, right, bottom = corner(view, tile)
    for y in range(top, bottom):
        for x in range(left, right):
            pixel = y * view.width + x
            light, red, green, blue, depth = ONE, ZERO, ZERO, ZERO, ZERO
            for number in range(drawing.counts[pixel]):
                place = np.int64(drawing.places[pixel * NEAREST + number])
                record = np.int64(bins.entries[2 * place]) * RECORD
                alpha, _, _ = coverage(records, record, x, y, view.radius)
                weight = alpha * light
                light = light * (ONE - alpha)
                red += weight * records[record + RED]
                green += weight * records[record + GREEN]
                blue += weight * records[record + BLUE]
                depth += weight * records[record + DEPTH]
                if number == 0 or weight > MUCH:
                    drawing.shown[bins.entries[2 * place + 1]] = 1
            drawing.image[3 * pixel] = red + light * background[0]
            drawing.image[3 * pixel + 1] = green + light * background[1]
            drawing.image[3 * pixel + 2] = blue + light * background[2]
            drawing.light[pixel], drawing.depth[pixel] = light, depth


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
    """Fill the slots of tiles until none is left."""
    tiles = bins.starts.size - 1
    bins, records, background = bare_bins(bins), pointer(records, 0), pointer(background, 0)
    drawing, slots, incoming = (
        bare_drawing(drawing),
        pointer(slots, 0),
        (pointer(incoming[0], 0), pointer(incoming[1], 0)),
    )
    lights, alphas = np.empty(NEAREST, np.float32), np.empty(NEAREST, np.float32)
    first = take_ticket(tickets, 0) * TILES_PER_TICKET
    while first < tiles:
        for tile in range(first, min(first + TILES_PER_TICKET, tiles)):
            for place in range(bins.starts[tile], bins.starts[tile + 1]):
                slot: Any = np.int64(bins.entries[2 * place + 1]) * SLOT
                for part in range(SLOT):
                    slots[slot + part] = ZERO
            left, top, right, bottom = corner(view, tile)
            for y in range(top, bottom):
                for x in range(left, right):
                    differentiate_pixel(
                        bins, records, background, view, drawing, incoming, (x, y, lights, alphas), slots
                    )
        first = take_ticket(tickets, 0) * TILES_PER_TICKET


@inlined
def differentiate_pixel(bins, records, background, view, drawing, incoming, work, slots):
    """Add one pixel's part to the slots of its discs, back to front.

    With B what a pixel would show of the discs behind one, ∂/∂alpha = light · ⟨g, color − B⟩; B folds from back to
    front without a division.
    """
    to_image, to_alpha = incoming
    x, y, lights, alphas = work
    pixel = y * view.width + x
    count = np.int64(drawing.counts[pixel])
    light = ONE
    for front in range(count):
        number: Any = np.int64(front)
        place = np.int64(drawing.places[pixel * NEAREST + number])
        lights[number] = light
        alphas[number], _, _ = coverage(records, np.int64(bins.entries[2 * place]) * RECORD, x, y, view.radius)
        light = light * (ONE - alphas[number])
    red, green, blue = to_image[3 * pixel], to_image[3 * pixel + 1], to_image[3 * pixel + 2]
    # The gradient of alpha acts like a fourth channel that is 1 on discs and 0 behind them.
    behind = red * background[0] + green * background[1] + blue * background[2]
    for back in range(count):
        number = np.int64(count - 1 - back)
        place = np.int64(drawing.places[pixel * NEAREST + number])
        record, slot = np.int64(bins.entries[2 * place]) * RECORD, np.int64(bins.entries[2 * place + 1]) * SLOT
        own = red * records[record + RED] + green * records[record + GREEN] + blue * records[record + BLUE]
        own = own + to_alpha[pixel]
        alpha, dx, dy = coverage(records, record, x, y, view.radius)
        weight = lights[number] * alpha
        pull = lights[number] * (own - behind) * (ONE + ONE) / view.radius
        slots[slot + TO_RED] += weight * red
        slots[slot + TO_GREEN] += weight * green
        slots[slot + TO_BLUE] += weight * blue
        slots[slot + TO_X] += pull * dx
        slots[slot + TO_Y] += pull * dy
        behind = alpha * own + (ONE - alpha) * behind


@kernel
def gather_slots(bins, slots, to_colors, to_means2d):
    """Sum the slots of every disc, tile by tile."""
    for index in range(to_colors.shape[0]):
        red, green, blue, x, y = ZERO, ZERO, ZERO, ZERO, ZERO
        for slot in range(bins.slots[index], bins.slots[index + 1]):
            place = slot * SLOT
            red, green, blue = red + slots[place], green + slots[place + TO_GREEN], blue + slots[place + TO_BLUE]
            x, y = x + slots[place + TO_X], y + slots[place + TO_Y]
        to_colors[index, 0], to_colors[index, 1], to_colors[index, 2] = red, green, blue
        to_means2d[index, 0], to_means2d[index, 1] = x, y
