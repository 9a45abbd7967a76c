"""A capture whose images, masks and head file are not here, only its tracking: what an avatar file knows of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError


@dataclass(frozen=True)
class CaptureWithoutImages(Capture):
    """The tracking of a capture, in place of the capture.

    Whatever needs an image, or a file of the capture, is refused in words that say what to do.

    Attributes:
        folder: The file that holds the tracking.
        scores: ARKit's expression scores of the frames, measured when it was written (`measured_scores`); NaN where
            there are none.
    """

    scores: Float[np.ndarray, "T 52"] | None = None

    @property
    def head_path(self) -> Path:
        """Refused: the head model is not in a file of its own."""
        return self._refuse("the head model of a capture")

    def image_path(self, subfolder: str, number: int) -> Path:
        """Refused: there are no images."""
        return self._refuse("an image of a capture")

    def image(self, number: int) -> NoReturn:
        """Refused: there are no images."""
        self._refuse("an image of a capture")

    def mask(self, number: int) -> NoReturn:
        """Refused: there are no masks."""
        self._refuse("a mask of a capture")

    def digest(self) -> NoReturn:
        """Refused: it is a digest of images."""
        self._refuse("the digest of a capture")

    def _refuse(self, what: str) -> NoReturn:
        raise InputError(
            f"{self.folder}: expected {what}, found an avatar file, which holds no photographs; use the run that it "
            "was exported from, or score its pictures: ggavatar-render FILE -o OUT, then ggavatar-eval --pred "
            "OUT/frames --capture CAPTURE"
        )
