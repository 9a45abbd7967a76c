"""Conversion of coverage to a clean 8-bit mask of one person."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8


def coverage_to_mask(coverage: Float[np.ndarray, "h w"], width: int, height: int) -> UInt8[np.ndarray, "H W"]:
    """Coverage in [0, 1] as an 8-bit mask of the given size."""
    if coverage.shape != (height, width):
        coverage = cv2.resize(coverage, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.round(np.clip(coverage, 0, 1) * 255).astype(np.uint8)


def keep_largest_component(mask: UInt8[np.ndarray, "H W"]) -> UInt8[np.ndarray, "H W"]:
    """The mask's largest connected component with small holes filled."""
    labels = cv2.connectedComponents((mask > 16).astype(np.uint8))[1]
    areas = np.bincount(labels.ravel())
    if len(areas) <= 1:
        return mask
    kept = mask * (labels == 1 + int(np.argmax(areas[1:])))
    holes = cv2.connectedComponents((kept <= 127).astype(np.uint8), connectivity=4)[1]
    small = np.bincount(holes.ravel()) < mask.size // 2000
    small[0] = False
    if small.any():
        kept[np.take(small, holes)] = 255
    return kept
