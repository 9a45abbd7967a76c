"""The pictures that refinement compares with: small, on a background, all in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from ggavatar.io.ordered_map import ordered_map


@dataclass(frozen=True)
class Pictures:
    """Small pictures of some rows of a tracking.

    Attributes:
        rows: Rows of the tracking.
        colors: Composited on the background.
        coverage: Of the person, 255 = person.
        full_size: Width and height of the images they were made from, px.
    """

    rows: tuple[int, ...]
    colors: UInt8[np.ndarray, "T H W 3"]
    coverage: UInt8[np.ndarray, "T H W"]
    full_size: tuple[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.colors.shape[2], self.colors.shape[1]

    def picture(self, place: int) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W 1"]]:
        """Colors and coverage in [0, 1]."""
        colors, coverage = (torch.from_numpy(part[place]).float() / 255 for part in (self.colors, self.coverage))
        return colors, coverage[..., None]


def read_pictures(
    rows: Sequence[int],
    read: Callable[[int], tuple[np.ndarray, np.ndarray]],
    side: int,
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Pictures:
    """Read and shrink pictures on several threads.

    Args:
        rows: Rows of the tracking, ascending.
        read: Gives the 8-bit image and mask of a row; thread-safe.
        side: Longer side of the small pictures, px; they are never enlarged.
        background: Color behind the person, sRGB in [0, 1].
    """
    behind = np.asarray(background, np.float32) * 255
    full = [0, 0]

    def small(row: int) -> tuple[np.ndarray, np.ndarray]:
        image, mask = read(row)
        full[:] = image.shape[1], image.shape[0]
        factor = min(1.0, side / max(full))
        coverage = mask.astype(np.float32)[..., None] / 255
        composed = image * coverage + behind * (1 - coverage)
        size = round(full[0] * factor), round(full[1] * factor)
        shrunk = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (composed, coverage[..., 0] * 255))
        colors, alpha = (np.rint(part).astype(np.uint8) for part in shrunk)
        return colors, alpha

    colors, coverage = zip(*ordered_map(small, rows), strict=True)
    return Pictures(tuple(rows), np.stack(colors), np.stack(coverage), (full[0], full[1]))
