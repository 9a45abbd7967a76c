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
"""Contrast, relative to the usual one, below which a frame counts as faded."""
MIN_FADE, MIN_FADE_AFTER_BLANK = 0.6, 0.8
"""Relative contrast that a fade must begin below, at the ends of a clip and beside blank frames."""
LONGEST_FADE = 90
"""Longest fade that is looked for, frames."""
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
    """How many of the first frames belong to a fade-in: the contrast rises in all of them, from far below the usual."""
    contrast = contrasts(thumbnails[: 2 * LONGEST_FADE])
    usual = float(np.median(contrast))
    count = int(np.argmax(contrast >= FADED * usual))
    if not 0 < count <= LONGEST_FADE or contrast[0] > (MIN_FADE_AFTER_BLANK if after_blank else MIN_FADE) * usual:
        return 0
    if np.diff(contrast[: count + 1]).min() <= 0:
        return 0
    return count if _correlation(thumbnails[count - 1], thumbnails[count]) >= MIN_CORRELATION else 0


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    values = np.corrcoef(first.ravel().astype(np.float64), second.ravel().astype(np.float64))
    return float(np.nan_to_num(values[0, 1]))
