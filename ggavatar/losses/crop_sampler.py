"""Where the crops of the perceptual loss lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class CropSampler:
    """Where the cheap mode looks: a square window in some steps, often centered on given boxes."""

    side: int = 128
    """Edge of the window, px; clipped to the image."""
    probability: float = 0.2
    """Chance that a step is looked at."""
    focused: float = 0.5
    """Chance that a window is centered on one of the boxes (mouth, eyes), if there are any."""

    def draw(
        self,
        height: int,
        width: int,
        generator: torch.Generator,
        boxes: Sequence[tuple[float, float, float, float]] = (),
    ) -> tuple[slice, slice] | None:
        """Rows and columns of a window, or None if this step is not looked at.

        Args:
            height: Of the image, px.
            width: Of the image, px.
            generator: On the CPU; five numbers are drawn whatever comes out.
            boxes: Left, top, right and bottom of regions that matter, px; one is chosen evenly.
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
