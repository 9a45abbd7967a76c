"""Choice of crops to enlarge: the squares with the largest error of the compared methods."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8


@dataclass(frozen=True)
class Crop:
    """A square part of an image, px.

    Attributes:
        left: First column.
        top: First row.
        size: Side length.
    """

    left: int
    top: int
    size: int

    def cut(self, image: UInt8[np.ndarray, "H W C"]) -> UInt8[np.ndarray, "S S C"]:
        """The pixels inside the square."""
        return image[self.top : self.top + self.size, self.left : self.left + self.size]

    def enlarged(self, image: UInt8[np.ndarray, "H W C"], side: int) -> UInt8[np.ndarray, "S S C"]:
        """The pixels inside, resampled to `side` px; an integer factor repeats pixels instead of interpolating."""
        cut = self.cut(image)
        whole = side % self.size == 0
        method = cv2.INTER_NEAREST if whole else (cv2.INTER_AREA if side < self.size else cv2.INTER_CUBIC)
        return cv2.resize(cut, (side, side), interpolation=method)


def choose_crops(
    error: Float[np.ndarray, "H W"], count: int, fraction: float = 0.2, focus: Float[np.ndarray, "H W"] | None = None
) -> list[Crop]:
    """Non-overlapping squares with the largest mean error, in descending order.

    Args:
        error: Error per pixel; for several methods their mean, so that the choice favors none.
        count: Number of crops; fewer are returned if no more fit.
        fraction: Side of a square relative to the shorter side of the image.
        focus: Weight per pixel in [0, 1], such as a face mask: the first square maximizes error × focus.

    Returns:
        The crops; ties are resolved toward the top left, so the choice is reproducible.
    """
    size = max(2, round(min(error.shape) * fraction))
    taken = np.zeros((error.shape[0] - size + 1, error.shape[1] - size + 1), bool)
    crops: list[Crop] = []
    while len(crops) < count and not taken.all():
        weighted = error * focus if focus is not None and focus.any() and not crops else error
        scores = np.where(taken, -np.inf, _window_means(weighted, size))
        top, left = (int(index) for index in np.unravel_index(np.argmax(scores), scores.shape))
        crops.append(Crop(left, top, size))
        taken[max(0, top - size + 1) : top + size, max(0, left - size + 1) : left + size] = True
    return crops


def _window_means(values: Float[np.ndarray, "H W"], size: int) -> Float[np.ndarray, "h w"]:
    """Mean of every square of a size, indexed by its top left corner."""
    means = cv2.boxFilter(values, -1, (size, size), anchor=(0, 0), normalize=True, borderType=cv2.BORDER_CONSTANT)
    return means[: values.shape[0] - size + 1, : values.shape[1] - size + 1]
