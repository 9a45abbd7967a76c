"""Temporal metrics: change between consecutive frames, flicker, and jitter of facial landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Image = UInt8[np.ndarray, "H W 3"]

STATIC_LEVELS = 2
"""Largest change of a channel, in 8-bit levels, at which a ground-truth pixel counts as static."""


def frame_difference_error(before: tuple[Image, Image], now: tuple[Image, Image]) -> float:
    """Mean absolute error of the change between two frames, range 1.

    The mean of |(prediction[t] − prediction[t−1]) − (truth[t] − truth[t−1])| over all pixels and channels. Constant
    errors cancel; flicker, lag and missing motion remain.

    Args:
        before: Prediction and ground truth of frame t − 1.
        now: Prediction and ground truth of frame t.
    """
    changes = [cv2.subtract(new, old, dtype=cv2.CV_16S) for new, old in zip(now, before, strict=True)]
    return cv2.norm(changes[0], changes[1], cv2.NORM_L1) / (255.0 * changes[0].size)


def flicker(
    before: tuple[Image, Image], now: tuple[Image, Image], mask: UInt8[np.ndarray, "H W"] | None = None
) -> float | None:
    """Mean absolute change of the prediction where the ground truth is static, range 1.

    Args:
        before: Prediction and ground truth of frame t − 1.
        now: Prediction and ground truth of frame t.
        mask: Non-zero where pixels may count (the person in both frames), or None for all.

    Returns:
        The mean over static pixels and channels; None if there is no static pixel.
    """
    static = (cv2.absdiff(now[1], before[1]).max(axis=2) <= STATIC_LEVELS).astype(np.uint8)
    if mask is not None:
        static &= (mask != 0).astype(np.uint8)
    count = int(cv2.countNonZero(static))
    if count == 0:
        return None
    change = cv2.absdiff(now[0], before[0])
    return float(change[static != 0].sum(dtype=np.int64)) / (3 * 255.0 * count)


def landmark_jitter(errors: Sequence[Float[np.ndarray, "L 2"] | None]) -> float | None:
    """Mean over the landmarks of the second difference |e[t−2] − 2 e[t−1] + e[t]| of their error.

    A constant offset or drift causes no jitter.

    Args:
        errors: Prediction minus ground truth in three consecutive frames, in any unit; None where no face was found.

    Returns:
        The jitter in the unit of the errors; None if one of the three is missing.
    """
    before, middle, now = errors
    if before is None or middle is None or now is None:
        return None
    return float(np.linalg.norm(before - 2 * middle + now, axis=1).mean())
