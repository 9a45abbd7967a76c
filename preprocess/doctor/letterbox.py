"""Black bars around a video: whoever converted it left them there, and masks take them for the person."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ggavatar.data.capture import Capture
from preprocess.tracking.geometry.rigid import evenly_spaced

FRAMES = 9
DARK = 20
"""No pixel of a bar is ever brighter, in 8-bit steps; one of a hundred may be."""
THIN = 0.008
"""Thinner borders, over the picture's side, are let pass."""
COUNTED = 0.25
"""Share of a bar that masks count as person, from which it is one to speak of."""


class Bars(NamedTuple):
    """Thickness at each side, px of the capture."""

    left: int
    top: int
    right: int
    bottom: int


def black_bars(capture: Capture) -> Bars:
    """The black bars that masks count as person; zeros where there are none."""
    numbers = [capture.frames[row] for row in evenly_spaced(len(capture.frames), FRAMES)]
    brightest = np.max([capture.image(number).max(axis=2) for number in numbers], axis=0)
    counted = np.mean([capture.mask(number) > 127 for number in numbers], axis=0)
    rows, columns = (np.percentile(brightest, 99, axis=axis) <= DARK for axis in (1, 0))
    return Bars(
        _thickness(columns, counted.T), _thickness(rows, counted),
        _thickness(columns[::-1], counted.T[::-1]), _thickness(rows[::-1], counted[::-1]),
    )  # fmt: skip


def _thickness(dark: Bool[np.ndarray, " N"], counted: np.ndarray) -> int:
    """How many lines are dark from the first on, if they are many and count as person; a dark picture has no bars."""
    thickness = int(np.argmin(dark)) if not dark.all() else 0
    known = thickness > THIN * len(dark) and counted[:thickness].mean() > COUNTED
    return thickness if known else 0


def cut_off(capture: Capture, bars: Bars) -> str:
    """The flags that crop the source to the largest square in the middle of what its bars leave."""
    crop = capture.source.get("crop")
    if not isinstance(crop, dict) or not all(isinstance(crop.get(key), int) for key in ("x", "y", "width", "height")):
        return "--resume --crop X,Y,WIDTH,HEIGHT"
    scale = crop["width"] / capture.width
    left, top, right, bottom = (int(np.ceil(thickness * scale)) for thickness in bars)
    width, height = crop["width"] - left - right, crop["height"] - top - bottom
    side = min(width, height)
    x, y = crop["x"] + left + (width - side) // 2, crop["y"] + top + (height - side) // 2
    return f"--resume --crop {x},{y},{side},{side}"
