"""Decoding a video or reading a folder of pictures, one frame at a time.

With the numbers and times the source gives them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from ggavatar.io.images import picture_header, read_rgb

PICTURES = frozenset({".png", ".jpg", ".jpeg"})
_SLICE = re.compile(r"^(\d*):(\d*)(?::(\d+))?$")


class DecodedFrame(NamedTuple):
    """One frame of a source.

    Attributes:
        number: Source frame number, from 0 for videos; the file's own number for pictures.
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
class Source(Protocol):
    """A video or a folder of pictures."""

    path: Path

    def frames(self) -> Iterator[DecodedFrame]:
        """All frames in order; each call starts again."""
        ...

    def losses(self) -> list[str]:
        """After `frames` has ended: what could not be decoded, in words."""
        ...


@dataclass(frozen=True)
class Selection:
    """Which frames of a source to keep.

    Attributes:
        fps: At most this many a second; None keeps all.
        start: First moment, s.
        end: Last moment, s.
        numbers: Source frame numbers, as slice.
    """

    fps: float | None = None
    start: float = 0.0
    end: float = math.inf
    numbers: slice = field(default_factory=lambda: slice(None))

    def keep(self, frames: Iterator[DecodedFrame]) -> Iterator[DecodedFrame]:
        """Filter frames; of those that fall into one interval of 1/fps the first is kept.

        Stops decoding where nothing more can follow.
        """
        first, stop, step = self.numbers.start or 0, self.numbers.stop, self.numbers.step or 1
        due, before = 0.0, None
        for frame in frames:
            if frame.time > self.end + 1e-6 or (stop is not None and frame.number >= stop):
                return
            if frame.time < self.start - 1e-6 or frame.number < first or (frame.number - first) % step:
                continue
            # Half a source interval of tolerance, so that jitter in time stamps drops no frame of a source of just
            # this rate.
            early = frame.time + (0.0 if before is None else 0.5 * (frame.time - before))
            before = frame.time
            if self.fps is None or early >= due:
                due = (math.floor(early * self.fps) + 1) / self.fps if self.fps else due
                yield frame


def parse_selection(fps: float | None, start: float, end: float | None, frames: str) -> Selection:
    """The selection that the options ask for; `InputError` if they make no sense."""
    match = _SLICE.match(frames)
    if not match or match[3] == "0":
        raise InputError(f"--frames: expected START:STOP:STEP like 0:500:2, found {frames!r}")
    if fps is not None and not 0 < fps < 10_000:
        raise InputError(f"--fps: expected a positive number, found {fps:g}")
    if not 0 <= start < math.inf or (end is not None and not start < end):
        raise InputError(f"--start/--end: expected 0 ≤ start < end in seconds, found {start:g} and {end}")
    numbers = slice(*(int(part) if part else None for part in match.groups()))
    return Selection(fps, start, math.inf if end is None else end, numbers)


def open_source(path: Path, fps: float | None = None) -> Source:
    """A video file or a folder of pictures as a source.

    Args:
        path: The file or folder.
        fps: Rate of a folder of pictures; 25 if None.

    Raises:
        InputError: No such file, or nothing that can be decoded.
    """
    from preprocess.video import Video

    if path.is_dir():
        return PictureFolder(path, fps or 25.0)
    if not path.exists():
        raise InputError(f"{path}: no such file; give a video or a folder of PNG or JPEG pictures")
    return Video(path)


class PictureFolder:
    """PNG or JPEG files whose names hold the frame number."""

    def __init__(self, path: Path, fps: float) -> None:
        self.path = path
        self._fps = fps
        self._files = numbered_pictures(path)
        if not self._files:
            raise InputError(
                f"{path}: no pictures in this folder; expected PNG or JPEG files with numbers in their names"
            )

    def frames(self) -> Iterator[DecodedFrame]:
        """All pictures by number; they must be of one size."""
        size: tuple[int, int] | None = None
        for row, (number, path) in enumerate(self._files.items()):
            header = picture_header(path)
            size = size or (header.width, header.height)
            if (header.width, header.height) != size:
                found = f"{header.width}×{header.height}"
                raise InputError(f"{path}: expected {size[0]}×{size[1]} px like the first picture, found {found}")
            yield DecodedFrame(number, row / self._fps, header.width, header.height, partial(read_rgb, path))

    def losses(self) -> list[str]:
        """Nothing is ever skipped silently in a folder."""
        return []


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """PNG and JPEG files of a folder by the last number in their names, ascending.

    By position if numbers are missing or repeat.
    """
    files = sorted(
        path for path in folder.iterdir() if path.suffix.lower() in PICTURES and not path.name.startswith(".")
    )
    digits = [re.findall(r"\d+", path.stem) for path in files]
    numbers = [int(found[-1]) if found and len(found[-1]) <= 9 else -1 for found in digits]
    if len(set(numbers)) == len(files) and min(numbers, default=0) >= 0:
        return dict(sorted(zip(numbers, files, strict=True)))
    return dict(enumerate(files))
