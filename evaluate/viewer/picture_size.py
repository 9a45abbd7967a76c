"""How large pictures are while something moves: as large as can be drawn often enough."""

from __future__ import annotations

from dataclasses import dataclass

SECONDS = 1 / 15
"""Time that a picture may take while something moves, s."""
LEAST_HEIGHT, MOST_HEIGHT = 256, 1080
"""Height of pictures, px; the window's is used in between."""
AVERAGING = 0.5
"""Weight of the last picture's time."""
LARGEST_STEP = 1.5
"""Largest change of the size from one picture to the next."""


@dataclass(frozen=True)
class PictureSize:
    """The size of moving pictures, relative to the window's.

    Attributes:
        scale: From 0 to 1.
    """

    scale: float = 0.5

    def after(self, seconds: float) -> PictureSize:
        """The next size, after a picture of this size took so long; its time is taken to go with its area."""
        wanted = self.scale * (SECONDS / max(seconds, 1e-4)) ** 0.5
        bounded = min(max(wanted, self.scale / LARGEST_STEP), self.scale * LARGEST_STEP)
        return PictureSize(min(1.0, max(0.05, (1 - AVERAGING) * self.scale + AVERAGING * bounded)))

    def moving(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of a picture while something moves, px."""
        wide, high = resting(width, height)
        factor = max(self.scale, min(1.0, LEAST_HEIGHT / high))
        return max(1, round(wide * factor)), max(1, round(high * factor))


def resting(width: int, height: int) -> tuple[int, int]:
    """Width and height of a picture of something that rests: those of the window, up to `MOST_HEIGHT`."""
    factor = min(1.0, MOST_HEIGHT / max(height, 1), 2 * MOST_HEIGHT / max(width, 1))
    return max(1, round(width * factor)), max(1, round(height * factor))
