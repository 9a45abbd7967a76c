"""Frames without a picture: blank ones (black, white, any single color), and fades from or to one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

THUMBNAIL = 32
"""Side of a thumbnail, px."""
MAX_BLANK_CONTRAST = 4.0
"""Standard deviation within a thumbnail, in 8-bit levels, up to which a frame shows nothing."""
FADED = 0.9
"""Contrast, relative to that after the fade, below which a frame counts as faded."""
MIN_FADE = 0.6
"""Relative contrast that a fade must begin below, unless it begins at a blank frame."""
LONGEST_FADE = 90
"""Longest fade that is looked for, frames."""
STEADY, STEADY_CHANGE = 5, 0.02
"""A fade is over where the contrast changes by less than this in so many frames."""
MIN_CORRELATION = 0.8
"""Correlation with the frame after the fade; during a fade the scene stays the same."""


def thumbnail(image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "32 32 3"]:
    """The image at 32 × 32 px, whatever its shape."""
    return cv2.resize(image, (THUMBNAIL, THUMBNAIL), interpolation=cv2.INTER_AREA)


def blank_frames(thumbnails: UInt8[np.ndarray, "T h w 3"]) -> Bool[np.ndarray, " T"]:
    """Frames that show a single color."""
    return contrasts(thumbnails) <= MAX_BLANK_CONTRAST


def contrasts(thumbnails: UInt8[np.ndarray, "T h w 3"]) -> Float[np.ndarray, " T"]:
    """Standard deviation over each thumbnail's pixels, mean of the channels, in 8-bit levels."""
    return thumbnails.astype(np.float64).std(axis=(1, 2)).mean(axis=1)


def faded_frames(thumbnails: UInt8[np.ndarray, "T h w 3"], blank: Bool[np.ndarray, " T"]) -> Bool[np.ndarray, " T"]:
    """Frames in which the picture fades in or out, at the ends of the clip or beside blank frames.

    A fade mixes the picture with one color, so it scales the contrast and leaves the scene as it is.
    """
    result = np.zeros(len(thumbnails), bool)
    for first, last in runs(~blank):
        part = slice(first, last + 1)
        count = _fade_in(thumbnails[part], after_blank=first > 0)
        result[first : first + count] = True
        count = _fade_in(thumbnails[part][::-1], after_blank=last + 1 < len(thumbnails))
        result[last + 1 - count : last + 1] = True
    return result


def runs(flags: Bool[np.ndarray, " T"] | Sequence[bool]) -> list[tuple[int, int]]:
    """First and last position of every run of true values."""
    padded = np.concatenate(([0], np.asarray(flags, dtype=np.int8), [0]))
    starts, ends = np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1)
    return [(int(start), int(end) - 1) for start, end in zip(starts, ends, strict=True)]


def _fade_in(thumbnails: np.ndarray, after_blank: bool) -> int:
    """How many of the first frames belong to a fade-in."""
    contrast = contrasts(thumbnails[: LONGEST_FADE + STEADY + 1])
    steady = _first_steady(contrast)
    if steady is None or steady == 0 or not (after_blank or contrast[0] < MIN_FADE * contrast[steady]):
        return 0
    rising = np.diff(contrast[: steady + 1]) > -STEADY_CHANGE * contrast[steady]
    if not rising.all() or _correlation(thumbnails[steady - 1], thumbnails[steady]) < MIN_CORRELATION:
        return 0
    return int(np.count_nonzero(contrast[:steady] < FADED * contrast[steady]))


def _first_steady(contrast: np.ndarray) -> int | None:
    """The first position after which the contrast stays the same for `STEADY` frames."""
    for place in range(len(contrast) - STEADY):
        following = contrast[place : place + STEADY + 1]
        if np.ptp(following) <= STEADY_CHANGE * following.max():
            return place
    return None


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    values = np.corrcoef(first.ravel().astype(np.float64), second.ravel().astype(np.float64))
    return float(np.nan_to_num(values[0, 1]))
