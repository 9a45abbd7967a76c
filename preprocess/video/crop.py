"""One crop and one resampling for a whole clip, and the camera intrinsics that result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.errors import InputError


@dataclass(frozen=True)
class Crop:
    """A rectangle of the source and the size it is resampled to; padded where it reaches beyond the source.

    Attributes:
        x: Left edge, px of the source.
        y: Top edge, px of the source.
        width: Width, px of the source.
        height: Height, px of the source.
        out_width: Width after resampling, px of the capture.
        out_height: Height after resampling, px of the capture.
    """

    x: int
    y: int
    width: int
    height: int
    out_width: int
    out_height: int

    def image(self, source: UInt8[np.ndarray, "H W C"] | UInt8[np.ndarray, "H W"]) -> np.ndarray:
        """The cropped and resampled image; pixels outside the source are black (0 in masks).

        An area filter shrinks, Lanczos enlarges.
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
        """The crop as plain numbers, for capture.json."""
        return dict(vars(self))


def crop_from_json(values: dict[str, Any]) -> Crop:
    """The crop whose numbers `Crop.json` gave."""
    return Crop(**values)


def whole_frame(width: int, height: int, size: int) -> Crop:
    """The uncropped source with its longer side resampled to `size` px."""
    factor = size / max(width, height)
    return Crop(0, 0, width, height, max(1, round(width * factor)), max(1, round(height * factor)))


def square_crop(center: tuple[float, float], side: float, width: int, height: int, size: int) -> Crop:
    """A square crop around a point, shifted to lie inside the source and at most as large as its shorter side."""
    length = min(round(side), width, height)
    x = int(np.clip(round(center[0] - length / 2), 0, width - length))
    y = int(np.clip(round(center[1] - length / 2), 0, height - length))
    return Crop(x, y, length, length, size, size)


def square_crop_around(boxes: Float[np.ndarray, "N 4"], width: int, height: int, size: int) -> Crop:
    """One square crop around the head boxes (left, top, right, bottom; px) of all frames, with hair and shoulders.

    The square spans the 1st to the 99th percentile of the boxes. Its side is at least twice the median head height, so
    that the upper shoulders are visible.
    """
    low, high = np.percentile(boxes[:, :2], 1, axis=0), np.percentile(boxes[:, 2:], 99, axis=0)
    head = float(np.median(boxes[:, 3] - boxes[:, 1]))
    side = max(2.0 * head, 1.15 * float(max(high - low)))
    center = (low + high) / 2
    # The hair above needs less room than the shoulders below.
    return square_crop((float(center[0]), float(center[1] + 0.12 * head)), side, width, height, size)


def parse_rectangle(text: str) -> tuple[int, int, int, int]:
    """The four numbers of `--crop X,Y,WIDTH,HEIGHT`, px.

    Raises:
        InputError: Not four whole numbers.
    """
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--crop: expected auto, none or X,Y,WIDTH,HEIGHT in whole px, found {text!r}") from error
    return x, y, width, height


def explicit_crop(text: str, width: int, height: int, size: int) -> Crop:
    """The crop that `--crop X,Y,WIDTH,HEIGHT` asks for; it may reach beyond the frame.

    Raises:
        InputError: Smaller than 16 px, more than four times the frame, or entirely outside of it.
    """
    x, y, crop_width, crop_height = parse_rectangle(text)
    outside = x >= width or y >= height or x + crop_width <= 0 or y + crop_height <= 0
    if crop_width < 16 or crop_height < 16 or outside or max(crop_width, crop_height) > 4 * max(width, height):
        raise InputError(
            f"--crop {text}: expected a rectangle of at least 16×16 px that overlaps the {width}×{height} px frame and "
            "is at most four times its size"
        )
    factor = size / max(crop_width, crop_height)
    return Crop(x, y, crop_width, crop_height, max(1, round(crop_width * factor)), max(1, round(crop_height * factor)))
