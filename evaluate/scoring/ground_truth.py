"""The ground truth of a frame as a protocol wants it: composited, resized, quantised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError

Color = tuple[float, float, float]


@runtime_checkable
class ImageSource(Protocol):
    """The part of `ggavatar.data.capture.Capture` that holds pictures."""

    def image(self, number: int) -> UInt8[np.ndarray, "H W 3"]:
        """8-bit sRGB of a source frame, background kept."""
        ...

    def mask(self, number: int) -> UInt8[np.ndarray, "H W"]:
        """Soft foreground mask of a source frame, 255 = person."""
        ...


@dataclass(frozen=True)
class GroundTruth:
    """How the ground truth is made of image and mask.

    Attributes:
        background: sRGB in [0, 1].
        size: Width and height, px; None for the capture's.
        binary_mask: Threshold the mask at one half before compositing.
    """

    background: Color
    size: tuple[int, int] | None = None
    binary_mask: bool = False

    def of(self, capture: ImageSource, number: int) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W"]]:
        """Image, composited as I·α + background·(1 − α), and mask of a source frame, rounded to 8 bits at the end.

        Raises:
            InputError: If the wanted size has another shape than the capture's pictures.
        """
        image, mask = capture.image(number), capture.mask(number).astype(np.float32) / 255
        if self.binary_mask:
            mask = (mask >= 0.5).astype(np.float32)
        composited = image * mask[..., None] + np.float32(255) * np.array(self.background, np.float32) * (
            1 - mask[..., None]
        )
        if self.size and self.size != (image.shape[1], image.shape[0]):
            _check_shape(image.shape[1], image.shape[0], *self.size)
            composited, mask = (
                cv2.resize(part, self.size, interpolation=cv2.INTER_AREA) for part in (composited, mask)
            )
        return np.rint(composited).astype(np.uint8), np.rint(mask * 255).astype(np.uint8)


def _check_shape(width: int, height: int, wanted_width: int, wanted_height: int) -> None:
    if abs(width * wanted_height - height * wanted_width) > 0.01 * width * wanted_height:
        raise InputError(
            f"expected a capture shaped like {wanted_width}×{wanted_height} px, found {width}×{height} px, which would "
            "be distorted; use --resolution native"
        )
