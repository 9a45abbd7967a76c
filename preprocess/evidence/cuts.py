"""Cuts of a video: where the picture changes at once, told from motion by how much it changes elsewhere."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

MIN_CHANGE, MIN_RELATIVE_CHANGE = 6.0, 6.0
"""Change from one frame to the next at a cut: in 8-bit levels, and relative to the median around it."""
MIN_COLOR_CHANGE, LARGE_CHANGE = 0.2, 15.0
"""A cut also changes the distribution of colors by this fraction, or the picture by so many levels.

The largest changes in six real clips without a cut are 0.06 and 8.7; a cut to another clip has 0.79 and 85.
"""
WINDOW = 12
"""Frames before and after a change that it is compared with."""
BINS = 6
"""Bins of the color histogram in each channel."""


def changes(thumbnails: UInt8[np.ndarray, "T h w 3"]) -> Float[np.ndarray, " T"]:
    """Mean absolute difference of every thumbnail from the one before, in 8-bit levels; 0 for the first."""
    result = np.zeros(len(thumbnails))
    if len(thumbnails) > 1:
        result[1:] = np.abs(np.diff(thumbnails.astype(np.int16), axis=0)).mean(axis=(1, 2, 3))
    return result


def color_histogram(thumbnails: UInt8[np.ndarray, "T h w 3"]) -> Float[np.ndarray, " B"]:
    """Distribution of the colors in some thumbnails; sums to 1."""
    bins = thumbnails.reshape(-1, 3).astype(np.int64) * BINS // 256
    counts = np.bincount((bins[:, 0] * BINS + bins[:, 1]) * BINS + bins[:, 2], minlength=BINS**3)
    return counts / max(int(counts.sum()), 1)


def color_distance(first: Float[np.ndarray, " B"], second: Float[np.ndarray, " B"]) -> float:
    """Fraction of the pixels whose color would have to change, in [0, 1]."""
    return float(0.5 * np.abs(first - second).sum())


def find_cuts(thumbnails: UInt8[np.ndarray, "T h w 3"]) -> list[int]:
    """Positions of the first frame after every cut, ascending."""
    change = changes(thumbnails)
    found = []
    for place in np.flatnonzero(change > MIN_CHANGE):
        around = np.concatenate((change[max(1, place - WINDOW) : place], change[place + 1 : place + 1 + WINDOW]))
        if len(around) and change[place] < MIN_RELATIVE_CHANGE * np.median(around):
            continue
        before, after = (color_histogram(thumbnails[place + step : place + step + 1]) for step in (-1, 0))
        if change[place] > LARGE_CHANGE or color_distance(before, after) > MIN_COLOR_CHANGE:
            found.append(int(place))
    return found
