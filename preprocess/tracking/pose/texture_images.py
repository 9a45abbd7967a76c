"""A small picture of the face in every frame, with the light taken out of it: what texture the skin shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt8

from preprocess.tracking.geometry.bilinear import bilinear

SIDE = 96
"""Side of the pictures, px of their own."""
MARGIN = 1.3
"""Side of what they show over the larger side of the face's box."""
FINE, COARSE = 1.5, 5.0
"""Details between these sizes are kept (standard deviations of two blurs), px of the pictures."""
DARKEST, FAINTEST = 8.0, 0.02
"""Grey level below which contrast is not read, and contrast below which details are not amplified to full size."""
STEPS = 32
"""Contrast is counted in such parts of its local root mean square."""


@dataclass(frozen=True)
class SkinPicture:
    """One frame's picture.

    Attributes:
        contrast: Details over their local root mean square, in `STEPS`.
        corner: Where its upper left corner lies in the image, px.
        scale: Its pixels per px of the image.
    """

    contrast: Int8[np.ndarray, "S S"]
    corner: Float[np.ndarray, "2"]
    scale: float


@dataclass(frozen=True)
class SkinPictures:
    """Pictures of all frames; see `SkinPicture`."""

    contrast: Int8[np.ndarray, "T S S"]
    corners: Float[np.ndarray, "T 2"]
    scales: Float[np.ndarray, " T"]

    @staticmethod
    def of(pictures: Sequence[SkinPicture]) -> SkinPictures:
        """Put together."""
        return SkinPictures(
            np.stack([picture.contrast for picture in pictures]),
            np.stack([picture.corner for picture in pictures]),
            np.array([picture.scale for picture in pictures]),
        )

    def sampled(
        self, frames: Int[np.ndarray, " K"], pixels: Float[np.ndarray, "K P 2"]
    ) -> tuple[Float[np.ndarray, "K P"], Float[np.ndarray, "K P 2"], Bool[np.ndarray, "K P"]]:
        """Contrast at image positions, its slope per px of the image, and whether they lie in the picture."""
        scale = self.scales[frames][:, None, None]
        values, slopes, known = bilinear(self.contrast, frames, (pixels - self.corners[frames][:, None]) * scale)
        return values / STEPS, slopes * scale / STEPS, known


def skin_picture(image: UInt8[np.ndarray, "H W 3"], points: Float[np.ndarray, "N 2"] | None) -> SkinPicture:
    """The picture of one RGB frame around its landmarks; an empty one where there are none."""
    if points is None:
        return SkinPicture(np.zeros((SIDE, SIDE), np.int8), np.zeros(2), 1.0)
    low, high = points.min(axis=0), points.max(axis=0)
    side = max(8, round(MARGIN * float((high - low).max())))
    left, top = np.floor((low + high) / 2 - side / 2).astype(int).tolist()
    height, width = image.shape[:2]
    rows = np.clip(np.arange(top, top + side), 0, height - 1)
    columns = np.clip(np.arange(left, left + side), 0, width - 1)
    inside = image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    grey = cv2.cvtColor(inside, cv2.COLOR_RGB2GRAY)[np.ix_(rows - rows[0], columns - columns[0])]
    small = cv2.resize(grey, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return SkinPicture(_contrast(small), np.array([left, top], float), SIDE / side)


def _contrast(grey: UInt8[np.ndarray, "S S"]) -> Int8[np.ndarray, "S S"]:
    """Details of the logarithm, which light from elsewhere hardly changes, over their local root mean square."""
    bright = np.log(grey.astype(np.float32) + DARKEST)
    details = cv2.GaussianBlur(bright, (0, 0), FINE) - cv2.GaussianBlur(bright, (0, 0), COARSE)
    strength = np.sqrt(cv2.GaussianBlur(details * details, (0, 0), COARSE) + FAINTEST**2)
    return np.clip(np.round(STEPS * details / strength), -127, 127).astype(np.int8)
