"""Text on images in DejaVu Sans, which comes with matplotlib, without a global pyplot figure.

matplotlib's renderer rather than Pillow's ImageDraw: Pillow is not a dependency of ours, and about as many lines of
measuring, fitting and blending would remain.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.font_manager import FontProperties

from evaluate.figures.fonts import font_families, our_fonts
from ggavatar.text.names import displayable

TEXT_COLOR = (34, 34, 40)
BACKGROUND = (255, 255, 255)
MUTED_COLOR = (110, 110, 120)

Color = tuple[int, int, int]


@lru_cache(maxsize=512)
def text_coverage(text: str, size: float, bold: bool = False) -> Float[np.ndarray, "H W"]:
    """Coverage of every pixel by a line of text, in [0, 1]; the height depends only on the size, so lines align.

    Args:
        text: Shown as one line; math markup is not interpreted.
        size: Font size (height of the em square), px.
        bold: Use the bold face.
    """
    line = displayable(text)
    font = FontProperties(family=list(font_families()), weight="bold" if bold else "normal", size=size)
    with our_fonts():
        measuring = RendererAgg(8, 8, 72)
        width = measuring.get_text_width_height_descent(line, font, False)[0] if line else 0
        renderer = RendererAgg(ceil(width) + 2, ceil(size * 1.3), 72)
        if line:
            renderer.draw_text(renderer.new_gc(), 1, round(size), line, font, 0)
    covered = np.asarray(renderer.buffer_rgba())[..., 3].astype(np.float32) / 255
    covered.setflags(write=False)
    return covered


def blend_text(
    image: UInt8[np.ndarray, "H W 3"], covered: Float[np.ndarray, "h w"], left: int, top: int, color: Color = TEXT_COLOR
) -> None:
    """Blend the coverage of a text into `image` in place, clipped at the edges."""
    first_row, first_column = max(0, -top), max(0, -left)
    rows, columns = max(0, image.shape[0] - top), max(0, image.shape[1] - left)
    part = covered[first_row:rows, first_column:columns, None]
    if part.size == 0:
        return
    row, column = max(0, top), max(0, left)
    target = image[row : row + part.shape[0], column : column + part.shape[1]]
    target[:] = np.round(target * (1 - part) + np.array(color, np.float32) * part)


def fit_text(text: str, size: float, width: int, bold: bool = False) -> Float[np.ndarray, "H W"]:
    """Coverage of a text no wider than `width` px: first in smaller type (down to 70 %), then cut with an ellipsis."""
    for factor in (1.0, 0.85, 0.7):
        covered = text_coverage(text, size * factor, bold)
        if covered.shape[1] <= width:
            return covered
    while len(text) > 1 and text_coverage(text + "…", size * 0.7, bold).shape[1] > width:
        text = text[:-1]
    return text_coverage(text + "…", size * 0.7, bold)


def text_band(
    texts: list[str],
    widths: list[int],
    size: float,
    color: Color = TEXT_COLOR,
    background: Color = BACKGROUND,
    bold: bool = False,
) -> UInt8[np.ndarray, "H W 3"]:
    """A band of fields side by side, each with a centered text.

    Args:
        texts: One text per field.
        widths: Widths of the fields, px.
        size: Font size, px.
        color: Color of the text.
        background: Color behind it.
        bold: Use the bold face.
    """
    height = ceil(size * 1.9)
    band = np.full((height, sum(widths), 3), background, np.uint8)
    left = 0
    for text, width in zip(texts, widths, strict=True):
        covered = fit_text(text, size, width - 4, bold)
        blend_text(band, covered, left + (width - covered.shape[1]) // 2, (height - covered.shape[0]) // 2, color)
        left += width
    return band
