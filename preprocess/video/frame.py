"""A decoded frame, and the interface of frame sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8


class DecodedFrame(NamedTuple):
    """One frame of a source.

    Attributes:
        number: Source frame number, from 0 in videos; the number in the file name in image folders.
        time: Time since the first frame, s.
        width: Width of the upright image with square pixels, px.
        height: Height of that image, px.
        load: Converts the pixels; call it before advancing to the next frame.
        alpha: The same for the alpha channel; None if the frame has none.
    """

    number: int
    time: float
    width: int
    height: int
    load: Callable[[], UInt8[np.ndarray, "H W 3"]]
    alpha: Callable[[], UInt8[np.ndarray, "H W"]] | None = None

    @property
    def image(self) -> UInt8[np.ndarray, "H W 3"]:
        """The upright image, 8-bit sRGB."""
        return self.load()


@runtime_checkable
class FrameSource(Protocol):
    """A video or an image folder."""

    path: Path

    def frames(self) -> Iterator[DecodedFrame]:
        """All frames in order; each call starts from the first."""
        ...

    def decode_errors(self) -> list[str]:
        """Descriptions of what could not be decoded; complete once `frames` is exhausted."""
        ...

    def conversions(self) -> list[str]:
        """What was found and done to bring frames to upright 8-bit sRGB; complete once `frames` is exhausted."""
        ...
