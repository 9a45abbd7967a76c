"""Performances of others for a web page: carried over by what is registered for it, since `ggavatar` only plays them.

`evaluate` registers the transfer of `ggavatar-render --drive` under the entry-point group below: a function
(run, path) → (frames per second, frame numbers, drives, cameras).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path

from ggavatar.core import Camera, Drive
from ggavatar.errors import InputError
from ggavatar.formats.web.clips import Clip
from ggavatar.training.run_folder import Run

ENTRY_POINT_GROUP = "ggavatar.performances"

Transferred = tuple[float, Sequence[int], Sequence[Drive], Sequence[Camera]]


def performance_clip(run: Run, path: Path) -> Clip:
    """A performance in a file or folder, carried over to the head of a run, as a clip.

    Raises:
        InputError: Nothing is installed that can do it, or the performance does not fit the head.
    """
    points = sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name)
    if not points:
        raise InputError(f"{path}: expected a program that carries performances over; run pip install -e . again")
    transfer: Callable[[Run, Path], Transferred] = points[0].load()
    fps, frames, drives, cameras = transfer(run, path)
    size = (run.capture.width, run.capture.height)
    return Clip(path.name, fps, tuple(frames), tuple(drives), tuple(camera.resized(*size) for camera in cameras))
