"""Pairing of the user's masks with frames: by number, and where several offsets fit the numbers, by image edges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

FRAMES = 32
SIDE = 256
MIN_RELATIVE_LEAD = 0.02
"""Relative lead in edge strength that another offset needs over the one that the numbers suggest."""


def find_mask_offset(
    numbers: Sequence[int],
    files: Mapping[int, Path],
    image: Callable[[int], np.ndarray],
    mask: Callable[[Path], np.ndarray],
) -> int:
    """The offset between masks and frames: mask number minus frame number.

    Args:
        numbers: Source frame numbers.
        files: Mask files by their own numbers.
        image: Reads a frame's image at the capture's size.
        mask: Reads a mask at the capture's size.

    Returns:
        The offset that gives the most frames a mask; among equals, the one whose mask outlines lie on image edges.
    """
    offsets = sorted({0, 1, -1, min(files) - numbers[0]}, key=abs)
    counts = {offset: sum(number + offset in files for number in numbers) for offset in offsets}
    best = max(offsets, key=lambda offset: counts[offset])
    candidates = [offset for offset in offsets if counts[offset] >= counts[best] - abs(offset - best)]
    common = [number for number in numbers if all(number + offset in files for offset in candidates)]
    if len(candidates) == 1 or len(common) < 2:
        return best
    chosen = [common[round(place)] for place in np.linspace(0, len(common) - 1, min(FRAMES, len(common)))]
    scores = dict.fromkeys(candidates, 0.0)
    for number in chosen:
        edges = _edges(image(number))
        for offset in candidates:
            scores[offset] += _edge_strength(edges, mask(files[number + offset]))
    leader = max(candidates, key=lambda offset: scores[offset])
    return leader if scores[leader] > scores[best] * (1 + MIN_RELATIVE_LEAD) else best


def _edges(image: np.ndarray) -> np.ndarray:
    """Edge strength of the image at reduced size."""
    gray = cv2.cvtColor(cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY).astype(
        np.float32
    )
    return np.hypot(cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1))


def _edge_strength(edges: np.ndarray, mask: np.ndarray) -> float:
    """Mean edge strength along a mask's outline."""
    small = (cv2.resize(mask, (SIDE, SIDE), interpolation=cv2.INTER_AREA) > 127).astype(np.uint8)
    outline = cv2.morphologyEx(small, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    return float(edges[outline].mean()) if outline.any() else 0.0
