"""Selection of frames from a source by rate, time and number."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from ggavatar.errors import InputError
from preprocess.video.frame import DecodedFrame

_SLICE = re.compile(r"^(\d*):(\d*)(?::(\d+))?$")


@dataclass(frozen=True)
class Selection:
    """Which frames of a source to keep.

    Attributes:
        fps: Maximum number of frames per second; None keeps all.
        start: First time to keep, s.
        end: Last time to keep, s.
        numbers: Source frame numbers to keep, as a slice.
    """

    fps: float | None = None
    start: float = 0.0
    end: float = math.inf
    numbers: slice = field(default_factory=lambda: slice(None))

    def keep(self, frames: Iterator[DecodedFrame]) -> Iterator[DecodedFrame]:
        """The selected frames; of those within one interval of 1/fps the first is kept.

        Decoding stops after the last frame that can be selected.
        """
        first, stop, step = self.numbers.start or 0, self.numbers.stop, self.numbers.step or 1
        due, before = 0.0, None
        for frame in frames:
            if frame.time > self.end + 1e-6 or (stop is not None and frame.number >= stop):
                return
            if frame.time < self.start - 1e-6 or frame.number < first or (frame.number - first) % step:
                continue
            # A tolerance of half a source interval, so that jittering timestamps drop no frame of a source with
            # exactly this rate.
            early = frame.time + (0.0 if before is None else 0.5 * (frame.time - before))
            before = frame.time
            if self.fps is None or early >= due:
                due = (math.floor(early * self.fps) + 1) / self.fps if self.fps else due
                yield frame
            if stop is not None and frame.number == stop - 1:
                return


def parse_selection(fps: float | None, start: float, end: float | None, frames: str) -> Selection:
    """The selection that `--fps`, `--start`, `--end` and `--frames` ask for.

    Raises:
        InputError: An option is malformed or out of range.
    """
    match = _SLICE.match(frames)
    if not match or match[3] == "0":
        raise InputError(f"--frames: expected START:STOP:STEP like 0:500:2, found {frames!r}")
    if fps is not None and not 0 < fps < 10_000:
        raise InputError(f"--fps: expected a positive number, found {fps:g}")
    if not 0 <= start < math.inf or (end is not None and not start < end):
        raise InputError(f"--start/--end: expected 0 ≤ start < end in seconds, found {start:g} and {end}")
    numbers = slice(*(int(part) if part else None for part in match.groups()))
    return Selection(fps, start, math.inf if end is None else end, numbers)
