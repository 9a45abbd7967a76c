"""Where a clip stands: a position that moves with the clock while it plays."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass


@dataclass(frozen=True)
class Playback:
    """A position in a clip.

    Attributes:
        frames: Source frame numbers, at least one.
        fps: Frames per second.
        start: Index in `frames` at the moment `since`, or where the clip rests.
        since: Moment at which it began to play, s; None while it rests.
    """

    frames: tuple[int, ...]
    fps: float
    start: int = 0
    since: float | None = None

    def index(self, now: float) -> int:
        """Index of the frame to show; after the last comes the first."""
        passed = 0 if self.since is None else int(max(0.0, now - self.since) * self.fps)
        return (self.start + passed) % len(self.frames)

    def frame(self, now: float) -> int:
        """Source number of the frame to show."""
        return self.frames[self.index(now)]

    @property
    def is_playing(self) -> bool:
        """Whether the position moves."""
        return self.since is not None

    def playing(self, now: float) -> Playback:
        """The clip, playing on from where it stands."""
        return dataclasses.replace(self, start=self.index(now), since=now)

    def resting(self, now: float) -> Playback:
        """The clip, stopped where it stands."""
        return dataclasses.replace(self, start=self.index(now), since=None)

    def at(self, index: int) -> Playback:
        """The clip, stopped at an index."""
        return dataclasses.replace(self, start=min(max(index, 0), len(self.frames) - 1), since=None)
