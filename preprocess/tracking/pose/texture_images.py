"""A small image of the face in every frame with the illumination removed: local contrast of the skin's texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt8

from preprocess.tracking.geometry.bilinear import bilinear

IMAGE_SIDE = 96
"""Width and height of the small images, px."""
FACE_MARGIN = 1.3
"""Side of the cropped square over the larger side of the face's bounding box."""
FINE_SIGMA, COARSE_SIGMA = 1.5, 5.0
"""Standard deviations of the two blurs of the band-pass, px of the small images."""
INTENSITY_OFFSET = 8.0
"""Added to gray levels before the logarithm, so that noise in the dark does not dominate."""
MINIMUM_CONTRAST = 0.02
"""Its square is added to the local mean square of the contrast, so that flat areas are not amplified."""
CONTRAST_STEPS = 32
"""Steps per unit of normalized contrast in which it is stored."""


@dataclass(frozen=True)
class SkinImage:
    """Normalized contrast of one frame's face.

    Attributes:
        contrast: Band-passed log intensity over its local root mean square, in 1/`CONTRAST_STEPS`.
        corner: Position of its upper left corner in the frame, px.
        scale: Its pixels per px of the frame.
    """

    contrast: Int8[np.ndarray, "S S"]
    corner: Float[np.ndarray, "2"]
    scale: float


@dataclass(frozen=True)
class SkinImages:
    """The `SkinImage` of every frame, stacked."""

    contrast: Int8[np.ndarray, "T S S"]
    corners: Float[np.ndarray, "T 2"]
    scales: Float[np.ndarray, " T"]

    @staticmethod
    def stack(images: Sequence[SkinImage]) -> SkinImages:
        """The images of all frames as arrays."""
        return SkinImages(
            np.stack([image.contrast for image in images]),
            np.stack([image.corner for image in images]),
            np.array([image.scale for image in images]),
        )

    def sample(
        self, frames: Int[np.ndarray, " K"], pixels: Float[np.ndarray, "K P 2"]
    ) -> tuple[Float[np.ndarray, "K P"], Float[np.ndarray, "K P 2"], Bool[np.ndarray, "K P"]]:
        """Contrast at positions in the frames, its derivatives per px, and whether the positions lie in the image."""
        scale = self.scales[frames][:, None, None]
        values, gradient, within = bilinear(self.contrast, frames, (pixels - self.corners[frames][:, None]) * scale)
        return values / CONTRAST_STEPS, gradient * scale / CONTRAST_STEPS, within


def skin_image(frame: UInt8[np.ndarray, "H W 3"], points: Float[np.ndarray, "N 2"] | None) -> SkinImage:
    """The skin image of an RGB frame around its landmarks; empty if there are none."""
    if points is None:
        return SkinImage(np.zeros((IMAGE_SIDE, IMAGE_SIDE), np.int8), np.zeros(2), 1.0)
    low, high = points.min(axis=0), points.max(axis=0)
    side = max(8, round(FACE_MARGIN * float((high - low).max())))
    left, top = np.floor((low + high) / 2 - side / 2).astype(int).tolist()
    height, width = frame.shape[:2]
    rows = np.clip(np.arange(top, top + side), 0, height - 1)
    columns = np.clip(np.arange(left, left + side), 0, width - 1)
    inside = frame[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    gray = cv2.cvtColor(inside, cv2.COLOR_RGB2GRAY)[np.ix_(rows - rows[0], columns - columns[0])]
    small = cv2.resize(gray, (IMAGE_SIDE, IMAGE_SIDE), interpolation=cv2.INTER_AREA)
    return SkinImage(_normalized_contrast(small), np.array([left, top], float), IMAGE_SIDE / side)


def _normalized_contrast(gray: UInt8[np.ndarray, "S S"]) -> Int8[np.ndarray, "S S"]:
    """Band-passed log intensity over its local root mean square, which illumination hardly changes."""
    log = np.log(gray.astype(np.float32) + INTENSITY_OFFSET)
    details = cv2.GaussianBlur(log, (0, 0), FINE_SIGMA) - cv2.GaussianBlur(log, (0, 0), COARSE_SIGMA)
    strength = np.sqrt(cv2.GaussianBlur(details * details, (0, 0), COARSE_SIGMA) + MINIMUM_CONTRAST**2)
    return np.clip(np.round(CONTRAST_STEPS * details / strength), -127, 127).astype(np.int8)
