"""Black bars around a video (letterboxing), which masks tend to count as person."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ggavatar.data.capture import Capture
from preprocess.tracking.geometry.rigid import evenly_spaced

FRAMES = 9
"""How many frames are sampled."""
MAX_BAR_BRIGHTNESS = 20
"""Brightness, in 8-bit levels, that at most one in a hundred pixels of a bar's line ever exceeds."""
MIN_BAR_FRACTION = 0.008
"""Thinnest bar that is reported, as a fraction of the image side."""
MIN_PERSON_FRACTION = 0.25
"""Fraction of a bar that masks must count as person for it to be reported."""


class Bars(NamedTuple):
    """Thickness of the bar at each side, px of the capture."""

    left: int
    top: int
    right: int
    bottom: int


def black_bars(capture: Capture) -> Bars:
    """Black bars that the masks count as person; zeros where there are none."""
    numbers = [capture.frames[row] for row in evenly_spaced(len(capture.frames), FRAMES)]
    brightest = np.max([capture.image(number).max(axis=2) for number in numbers], axis=0)
    counted = np.mean([capture.mask(number) > 127 for number in numbers], axis=0)
    rows, columns = (np.percentile(brightest, 99, axis=axis) <= MAX_BAR_BRIGHTNESS for axis in (1, 0))
    return Bars(
        _thickness(columns, counted.T), _thickness(rows, counted),
        _thickness(columns[::-1], counted.T[::-1]), _thickness(rows[::-1], counted[::-1]),
    )  # fmt: skip


def _thickness(dark: Bool[np.ndarray, " N"], counted: np.ndarray) -> int:
    """Number of dark lines from the first on, if it is large enough and they count as person, else 0."""
    thickness = int(np.argmin(dark)) if not dark.all() else 0
    is_bar = thickness > MIN_BAR_FRACTION * len(dark) and counted[:thickness].mean() > MIN_PERSON_FRACTION
    return thickness if is_bar else 0


def crop_flags(capture: Capture, bars: Bars) -> str:
    """The flags that crop the source to the largest centered square without its bars."""
    crop = capture.source.get("crop")
    if not isinstance(crop, dict) or not all(isinstance(crop.get(key), int) for key in ("x", "y", "width", "height")):
        return "--resume --crop X,Y,WIDTH,HEIGHT"
    scale = crop["width"] / capture.width
    left, top, right, bottom = (int(np.ceil(thickness * scale)) for thickness in bars)
    width, height = crop["width"] - left - right, crop["height"] - top - bottom
    side = min(width, height)
    x, y = crop["x"] + left + (width - side) // 2, crop["y"] + top + (height - side) // 2
    return f"--resume --crop {x},{y},{side},{side}"
