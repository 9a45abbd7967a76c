"""Performances of others for exports: carried over by what is registered for it, since `ggavatar` only stores them.

`evaluate` registers the transfer of `ggavatar-render --drive` under the entry-point group below: a function
(run, path, options) → `CarriedOver`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from ggavatar.core import Camera, Drive
from ggavatar.errors import InputError
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.training.run_folder import Run

ENTRY_POINT_GROUP = "ggavatar.performances"


@dataclass(frozen=True)
class CarriedOver:
    """A performance in an avatar's own parameters.

    Attributes:
        fps: Frames per second.
        frames: Source frame numbers of the driver.
        drives: What animates the avatar.
        cameras: What takes the picture, at the size of the avatar's capture.
        note: What could not be carried over as asked, in words; empty if all was.
    """

    fps: float
    frames: tuple[int, ...]
    drives: tuple[Drive, ...]
    cameras: tuple[Camera, ...]
    note: str = ""

    def __repr__(self) -> str:
        """Length and rate."""
        return f"Performance({len(self.frames)} frames at {self.fps:g} fps{', ' + self.note if self.note else ''})"


Transfer = Callable[[Run, Path, DrivingOptions], CarriedOver]


def carried_over(run: Run, path: Path, options: DrivingOptions) -> CarriedOver:
    """A performance in a file or folder, carried over to the avatar of a run.

    Raises:
        InputError: Nothing is installed that can do it, or the performance cannot be read or does not fit the avatar.
    """
    points = sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name)
    if not points:
        raise InputError(f"{path}: expected a program that carries performances over; run pip install -e . again")
    transfer: Transfer = points[0].load()
    return transfer(run, path, options)
