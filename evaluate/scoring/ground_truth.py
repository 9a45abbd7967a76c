"""The ground truth of a frame under a protocol: composited, resized, quantized."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import UInt8

from ggavatar.data.background import Color
from ggavatar.errors import InputError


@runtime_checkable
class ImageSource(Protocol):
    """Images and masks by frame number, as in `ggavatar.data.capture.Capture`."""

    def image(self, number: int) -> UInt8[np.ndarray, "H W 3"]:
        """8-bit sRGB image of a source frame, with its background."""
        ...

    def mask(self, number: int) -> UInt8[np.ndarray, "H W"]:
        """Soft foreground mask of a source frame, 255 = person."""
        ...


@dataclass(frozen=True)
class GroundTruth:
    """How ground truth is made from image and mask.

    Attributes:
        background: sRGB in [0, 1].
        size: Width and height, px; None for the capture's.
        binary_mask: Threshold the mask at 0.5 before compositing.
    """

    background: Color
    size: tuple[int, int] | None = None
    binary_mask: bool = False

    def image_and_mask(
        self, capture: ImageSource, number: int
    ) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W"]]:
        """Image, composited as I·α + background·(1 − α), and mask of a source frame, both rounded to 8 bits at the end.

        Raises:
            InputError: `size` has another aspect ratio than the capture's images.
        """
        image, mask = capture.image(number), capture.mask(number).astype(np.float32) / 255
        if self.binary_mask:
            mask = (mask >= 0.5).astype(np.float32)
        composited = image * mask[..., None] + np.float32(255) * np.array(self.background, np.float32) * (
            1 - mask[..., None]
        )
        if self.size and self.size != (image.shape[1], image.shape[0]):
            _check_aspect_ratio(image.shape[1], image.shape[0], *self.size)
            composited, mask = (
                cv2.resize(part, self.size, interpolation=cv2.INTER_AREA) for part in (composited, mask)
            )
        return np.rint(composited).astype(np.uint8), np.rint(mask * 255).astype(np.uint8)


def _check_aspect_ratio(width: int, height: int, wanted_width: int, wanted_height: int) -> None:
    if abs(width * wanted_height - height * wanted_width) > 0.01 * width * wanted_height:
        raise InputError(
            f"expected the aspect ratio of {wanted_width}×{wanted_height} px, found a capture of {width}×{height} px, "
            "which would be distorted; use --resolution native"
        )
