"""A decoded frame, and what any source of frames offers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8


class DecodedFrame(NamedTuple):
    """One frame of a source.

    Attributes:
        number: FrameSource frame number, from 0 for videos; the file's own number for pictures.
        time: Since the first frame, s.
        width: px, upright.
        height: px, upright.
        load: Converts the pixels; call it before asking for the next frame.
    """

    number: int
    time: float
    width: int
    height: int
    load: Callable[[], UInt8[np.ndarray, "H W 3"]]

    @property
    def image(self) -> UInt8[np.ndarray, "H W 3"]:
        """8-bit sRGB, upright."""
        return self.load()


@runtime_checkable
class FrameSource(Protocol):
    """A video or a folder of pictures."""

    path: Path

    def frames(self) -> Iterator[DecodedFrame]:
        """All frames in order; each call starts again."""
        ...

    def losses(self) -> list[str]:
        """After `frames` has ended: what could not be decoded, in words."""
        ...
