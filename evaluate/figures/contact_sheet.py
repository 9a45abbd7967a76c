"""A contact sheet: rows and columns of images with headings, row labels and captions.

Composed as an array because the images must stay pixel-exact, which matplotlib's axes do not guarantee.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from evaluate.figures.text import BACKGROUND, MUTED_COLOR, TEXT_COLOR, blend_text, fit_text, text_band

GAP = 6
"""Space between tiles, px."""


@dataclass(frozen=True)
class Row:
    """Images side by side, all of one size.

    Attributes:
        tiles: One image per column; None leaves the cell empty.
        label: Row label, written vertically at the left; empty for none.
        captions: Texts under the tiles; empty for none.
        space: Extra space above the row, px.
    """

    tiles: Sequence[np.ndarray | None]
    label: str = ""
    captions: Sequence[str] = ()
    space: int = 0

    @property
    def height(self) -> int:
        """Height of the tiles, px."""
        return max(tile.shape[0] for tile in self.tiles if tile is not None)

    @property
    def width(self) -> int:
        """Width of one tile, px."""
        return max(tile.shape[1] for tile in self.tiles if tile is not None)


def contact_sheet(rows: Sequence[Row], headings: Sequence[str] = (), note: str = "") -> UInt8[np.ndarray, "H W 3"]:
    """Lay out rows under headings.

    Args:
        rows: Rows from the top, all with the same number of columns.
        headings: One per column, or none at all.
        note: A line at the bottom.

    Returns:
        The sheet on a white background.

    Raises:
        ValueError: The numbers of columns differ.
    """
    columns = len(rows[0].tiles)
    if any(len(row.tiles) != columns for row in rows) or (headings and len(headings) != columns):
        raise ValueError(
            f"expected {columns} columns, found {[len(row.tiles) for row in rows]} and {len(headings)} headings"
        )
    width, size = max(row.width for row in rows), font_size(max(row.width for row in rows))
    margin = round(2.2 * size) if any(row.label for row in rows) else 0
    bands = [_headings(headings, width, size, margin)] if headings else []
    bands += [_row(row, width, size, margin) for row in rows]
    if note:
        bands.append(_line(note, columns * (width + GAP) - GAP + margin, size))
    return _framed(np.concatenate(bands))


def font_size(width: int) -> float:
    """Font size for tiles of a width, px: legible when the sheet is scaled down to a page."""
    return float(np.clip(width / 14, 12, 30))


def resize_to_width(image: UInt8[np.ndarray, "H W C"], width: int) -> UInt8[np.ndarray, "h w C"]:
    """An image resampled to a width, keeping its aspect ratio: averaged when shrunk, interpolated when enlarged."""
    if image.shape[1] == width:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    method = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
    return cv2.resize(image, (width, height), interpolation=method)


def _headings(headings: Sequence[str], width: int, size: float, margin: int) -> np.ndarray:
    band = text_band(list(headings), [width + GAP] * len(headings), size, TEXT_COLOR, bold=True)
    return _padded(band[:, : band.shape[1] - GAP], margin)


def _row(row: Row, width: int, size: float, margin: int) -> np.ndarray:
    band = np.full((row.height, len(row.tiles) * (width + GAP) - GAP, 3), BACKGROUND, np.uint8)
    for index, tile in enumerate(row.tiles):
        if tile is not None:
            left = index * (width + GAP) + (width - tile.shape[1]) // 2
            band[: tile.shape[0], left : left + tile.shape[1]] = tile
    parts = [np.full((row.space, band.shape[1], 3), BACKGROUND, np.uint8), band]
    if row.captions:
        caption = text_band(list(row.captions), [width + GAP] * len(row.captions), size * 0.85, MUTED_COLOR)
        parts.append(caption[:, : band.shape[1]])
    else:
        parts.append(np.full((GAP, band.shape[1], 3), BACKGROUND, np.uint8))
    laid = _padded(np.concatenate(parts), margin)
    if row.label:
        upward = np.rot90(fit_text(row.label, size, row.height))
        blend_text(
            laid, upward, (margin - upward.shape[1]) // 2, row.space + (row.height - upward.shape[0]) // 2, TEXT_COLOR
        )
    return laid


def _line(text: str, width: int, size: float) -> np.ndarray:
    return text_band([text], [width], size * 0.85, MUTED_COLOR)


def _padded(band: np.ndarray, margin: int) -> np.ndarray:
    return cv2.copyMakeBorder(band, 0, 0, margin, 0, cv2.BORDER_CONSTANT, value=BACKGROUND)


def _framed(image: np.ndarray) -> np.ndarray:
    return cv2.copyMakeBorder(image, GAP, GAP, GAP, GAP, cv2.BORDER_CONSTANT, value=BACKGROUND)
