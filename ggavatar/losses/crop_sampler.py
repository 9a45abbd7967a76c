"""Random crops for the perceptual loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

Box = tuple[float, float, float, float]
"""Left, top, right and bottom of an image region, px."""


@dataclass(frozen=True)
class CropSampler:
    """A square window in a random subset of the steps, often centered on given boxes."""

    side: int = 128
    """Edge of the window, px; clipped to the image."""
    probability: float = 0.2
    """Probability that a step has a window."""
    focused: float = 0.5
    """Probability that a window is centered on one of the boxes (mouth, eyes), if there are any."""

    def draw(
        self,
        height: int,
        width: int,
        generator: torch.Generator,
        boxes: Sequence[Box] = (),
    ) -> tuple[slice, slice] | None:
        """Rows and columns of a window, or None if this step has none.

        Args:
            height: Height of the image, px.
            width: Width of the image, px.
            generator: A generator on the CPU; every call draws five numbers.
            boxes: Regions to center windows on; each is equally likely.
        """
        look, focus, which, across, down = torch.rand(5, generator=generator).tolist()
        if look >= self.probability:
            return None
        tall, wide = min(self.side, height), min(self.side, width)
        left, top = across * (width - wide + 1), down * (height - tall + 1)
        if boxes and focus < self.focused:
            box = boxes[int(which * len(boxes))]
            left, top = (box[0] + box[2] - wide) / 2, (box[1] + box[3] - tall) / 2
        row, column = min(max(int(top), 0), height - tall), min(max(int(left), 0), width - wide)
        return slice(row, row + tall), slice(column, column + wide)
