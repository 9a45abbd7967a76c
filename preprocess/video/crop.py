"""One crop and one resampling for a whole clip, and what they do to the camera's intrinsics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.errors import InputError


@dataclass(frozen=True)
class Crop:
    """A parse_rectangle of the source and the size it is resampled to; it may reach beyond the source, which is then padded.

    Attributes:
        x: Left edge, px of the source.
        y: Top edge, px of the source.
        width: px of the source.
        height: px of the source.
        out_width: px of the capture.
        out_height: px of the capture.
    """

    x: int
    y: int
    width: int
    height: int
    out_width: int
    out_height: int

    def image(self, source: UInt8[np.ndarray, "H W C"] | UInt8[np.ndarray, "H W"]) -> np.ndarray:
        """The cropped and resampled image; outside the source it is black (0 in masks).

        Area filter to shrink, Lanczos to enlarge.
        """
        import cv2

        height, width = source.shape[:2]
        left, top = max(0, -self.x), max(0, -self.y)
        right, bottom = max(0, self.x + self.width - width), max(0, self.y + self.height - height)
        part = source[max(0, self.y) : self.y + self.height, max(0, self.x) : self.x + self.width]
        if left or top or right or bottom:
            part = cv2.copyMakeBorder(part, top, bottom, left, right, cv2.BORDER_CONSTANT, value=(0, 0, 0))
        if (self.width, self.height) == (self.out_width, self.out_height):
            return np.ascontiguousarray(part)
        shrinking = self.out_width <= self.width
        return cv2.resize(
            part, (self.out_width, self.out_height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LANCZOS4
        )

    def intrinsics(self, source: Float[np.ndarray, "*T 3 3"]) -> Float[np.ndarray, "*T 3 3"]:
        """Intrinsics in px of the capture from those in px of the source (edges aligned, pixel centers at +0.5)."""
        shift = np.array([[1.0, 0, -self.x], [0, 1, -self.y], [0, 0, 1]])
        scale = np.diag([self.out_width / self.width, self.out_height / self.height, 1.0])
        return scale @ shift @ source

    def json(self) -> dict[str, int]:
        """As plain numbers, for capture.json."""
        return dict(vars(self))


def crop_from_json(values: dict[str, Any]) -> Crop:
    """The crop that `Crop.json` wrote."""
    return Crop(**values)


def whole_frame(width: int, height: int, size: int) -> Crop:
    """The uncropped source, its longer side resampled to `size` px."""
    factor = size / max(width, height)
    return Crop(0, 0, width, height, max(1, round(width * factor)), max(1, round(height * factor)))


def square_crop(center: tuple[float, float], side: float, width: int, height: int, size: int) -> Crop:
    """A square around a point.

    Moved inside the source where it can be, cut down to its shorter side where it cannot.
    """
    length = min(round(side), width, height)
    x = int(np.clip(round(center[0] - length / 2), 0, width - length))
    y = int(np.clip(round(center[1] - length / 2), 0, height - length))
    return Crop(x, y, length, length, size, size)


def square_around(boxes: Float[np.ndarray, "N 4"], width: int, height: int, size: int) -> Crop:
    """One square for all frames around head boxes (left, top, right, bottom; px), with room for hair and shoulders.

    The head stays complete in 98 % of the frames; the side is twice the usual head, so that the shoulders' upper
    part is in it.
    """
    low, high = np.percentile(boxes[:, :2], 1, axis=0), np.percentile(boxes[:, 2:], 99, axis=0)
    head = float(np.median(boxes[:, 3] - boxes[:, 1]))
    side = max(2.0 * head, 1.15 * float(max(high - low)))
    center = (low + high) / 2
    # Hair above needs less room than shoulders below.
    return square_crop((float(center[0]), float(center[1] + 0.12 * head)), side, width, height, size)


def parse_rectangle(text: str) -> tuple[int, int, int, int]:
    """What `--crop X,Y,WIDTH,HEIGHT` says, px."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--crop: expected auto, none or X,Y,WIDTH,HEIGHT in whole px, found {text!r}") from error
    return x, y, width, height


def explicit_crop(text: str, width: int, height: int, size: int) -> Crop:
    """The crop of `--crop X,Y,WIDTH,HEIGHT`; it may reach beyond the frame."""
    x, y, crop_width, crop_height = parse_rectangle(text)
    outside = x >= width or y >= height or x + crop_width <= 0 or y + crop_height <= 0
    if crop_width < 16 or crop_height < 16 or outside or max(crop_width, crop_height) > 4 * max(width, height):
        raise InputError(
            f"--crop {text}: expected a parse_rectangle of at least 16 px that overlaps the {width}×{height} px frame"
        )
    factor = size / max(crop_width, crop_height)
    return Crop(x, y, crop_width, crop_height, max(1, round(crop_width * factor)), max(1, round(crop_height * factor)))
