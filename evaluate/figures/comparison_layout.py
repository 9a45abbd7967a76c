"""Layout of the comparison: three rows per frame for several methods, one row per frame for a single method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from evaluate.figures.contact_sheet import GAP, Row, contact_sheet, font_size, resize_to_width
from evaluate.figures.crops import Crop, choose_crops
from evaluate.figures.error_map import error_colors, scale_bar, shared_limit
from evaluate.figures.text import BACKGROUND, MUTED_COLOR, TEXT_COLOR, Color, blend_text, text_coverage
from evaluate.metrics.pixels import absolute_error, psnr

CROP_COLORS: tuple[Color, ...] = ((0, 158, 115), (213, 94, 0), (0, 114, 178))


@dataclass(frozen=True)
class ComparisonFrame:
    """One frame with the predictions of several methods.

    Attributes:
        label: Row label.
        truth: Ground truth.
        predictions: Images of the same size by method, in the order of the columns.
        focus: Mask of the most important part, such as the face; the first crop is chosen inside it.
    """

    label: str
    truth: UInt8[np.ndarray, "H W 3"]
    predictions: Mapping[str, UInt8[np.ndarray, "H W 3"]]
    focus: UInt8[np.ndarray, "H W"] | None = None

    def errors(self) -> dict[str, Float[np.ndarray, "H W"]]:
        """Error maps by method."""
        return {name: absolute_error(image, self.truth) for name, image in self.predictions.items()}

    def crops(self, count: int) -> list[Crop]:
        """Squares with the largest mean error over the methods, the first of them inside the focus."""
        focus = None if self.focus is None else self.focus.astype(np.float32) / 255
        return choose_crops(np.mean(list(self.errors().values()), axis=0), count, focus=focus)


def comparison(
    frames: Sequence[ComparisonFrame], crops: int = 2, width: int | None = None
) -> UInt8[np.ndarray, "H W 3"]:
    """Images with PSNR, enlarged crops and error maps on one color scale.

    Args:
        frames: Frames from the top, all with the same methods.
        crops: Number of enlarged crops per image; 0 for none.
        width: Width of one image, px; by default that of the images, clamped to 240–400.
    """
    names = list(frames[0].predictions)
    if any(list(frame.predictions) != names for frame in frames):
        found = [list(frame.predictions) for frame in frames]
        raise ValueError(f"expected the methods {names} in every frame, found {found}")
    width = width or int(np.clip(frames[0].truth.shape[1], 240, 400))
    limit = shared_limit(error for frame in frames for error in frame.errors().values())
    note = f"Error: mean |difference| of R, G, B, 0 to {limit:g}."
    if crops:
        first = ", the first in the face" if all(frame.focus is not None for frame in frames) else ""
        note = f"Crops: where the error is largest{first}. {note}"
    if len(names) == 1:
        middle = ["Crops: truth, prediction"] if crops else []
        headings = ["Ground truth", names[0], *middle, f"Error, 0 to {limit:g}"]
        return contact_sheet([_single(frame, crops, width, limit) for frame in frames], headings, note)
    spaces = [3 * GAP * (index > 0) for index in range(len(frames))]
    rows = [
        row for frame, space in zip(frames, spaces, strict=True) for row in _several(frame, crops, width, limit, space)
    ]
    return contact_sheet(rows, ["Ground truth", *names], note)


def _single(frame: ComparisonFrame, count: int, width: int, limit: float) -> Row:
    """One row: ground truth, prediction, crops of both, error."""
    ((_, prediction),) = frame.predictions.items()
    crops = frame.crops(count)
    tiles = [_outlined(image, crops, width) for image in (frame.truth, prediction)]
    captions = ["", f"{psnr(prediction, frame.truth):.2f} dB"]
    if count:
        pairs = [_enlarged(image, crops, tiles[0].shape[0], upright=True) for image in (frame.truth, prediction)]
        tiles.append(_side_by_side(pairs, width))
        captions.append("")
    tiles.append(resize_to_width(error_colors(absolute_error(prediction, frame.truth), limit), width))
    return Row(tiles, frame.label, [*captions, ""])


def _side_by_side(strips: Sequence[np.ndarray], width: int) -> UInt8[np.ndarray, "H W 3"]:
    """Two strips as one tile no wider than `width`."""
    gap = np.full((strips[0].shape[0], GAP, 3), BACKGROUND, np.uint8)
    both = np.concatenate((strips[0], gap, strips[1]), axis=1)
    return resize_to_width(both, width) if both.shape[1] > width else both


def _several(frame: ComparisonFrame, count: int, width: int, limit: float, space: int) -> list[Row]:
    """Three rows: images, crops, errors."""
    crops = frame.crops(count)
    images = [frame.truth, *frame.predictions.values()]
    captions = ["", *(f"{psnr(image, frame.truth):.2f} dB" for image in frame.predictions.values())]
    rows = [Row([_outlined(image, crops, width) for image in images], frame.label, captions, space)]
    if crops:
        rows.append(Row([_enlarged(image, crops, width) for image in images], "crops"))
    maps = [resize_to_width(error_colors(error, limit), width) for error in frame.errors().values()]
    rows.append(Row([_legend(maps[0].shape[0], width, limit), *maps], "error"))
    return rows


def _outlined(image: np.ndarray, crops: Sequence[Crop], width: int) -> np.ndarray:
    """An image with the outlines of the crops."""
    shown, factor = resize_to_width(image, width).copy(), width / image.shape[1]
    for crop, color in zip(crops, CROP_COLORS, strict=False):
        first = (round(crop.left * factor), round(crop.top * factor))
        last = (round((crop.left + crop.size) * factor) - 1, round((crop.top + crop.size) * factor) - 1)
        cv2.rectangle(shown, first, last, color, 2)
    return shown


def _enlarged(image: np.ndarray, crops: Sequence[Crop], length: int, upright: bool = False) -> np.ndarray:
    """The crops in a row (or upright in a column) of a length, px, each framed in its color."""
    side = (length - GAP * (len(crops) - 1)) // len(crops)
    band = np.full((side, length, 3), BACKGROUND, np.uint8)
    for index, (crop, color) in enumerate(zip(crops, CROP_COLORS, strict=False)):
        tile = crop.enlarged(image, side)
        cv2.rectangle(tile, (0, 0), (side - 1, side - 1), color, 3)
        start = index * (side + GAP)
        band[:, start : start + side] = tile.transpose(1, 0, 2) if upright else tile
    return band.transpose(1, 0, 2).copy() if upright else band


def _legend(height: int, width: int, limit: float) -> np.ndarray:
    """The labeled color scale, in the cell below the ground truth."""
    tile = np.full((height, width, 3), BACKGROUND, np.uint8)
    size, bar = font_size(width), scale_bar(max(8, height // 14), round(width * 0.8))
    top, left = height // 2 - bar.shape[0], (width - bar.shape[1]) // 2
    tile[top : top + bar.shape[0], left : left + bar.shape[1]] = bar
    for text, position in (("0", 0.0), (f"{limit / 2:g}", 0.5), (f"≥ {limit:g}", 1.0)):
        covered = text_coverage(text, size * 0.85)
        offset = round(position * (bar.shape[1] - covered.shape[1]))
        blend_text(tile, covered, left + offset, top + bar.shape[0] + 4, MUTED_COLOR)
    title = text_coverage("mean |difference|", size * 0.85)
    blend_text(tile, title, (width - title.shape[1]) // 2, top - title.shape[0] - 6, TEXT_COLOR)
    return tile
