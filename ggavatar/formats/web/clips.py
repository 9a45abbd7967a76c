"""Clips of a web avatar: drives and cameras over time, from frames of the run's capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from ggavatar.core import Camera, Drive
from ggavatar.errors import InputError
from ggavatar.training.run_folder import Run

MAX_CLIP_FRAMES = 10_000
SPARSE_FPS = 4.0
"""Largest rate of frames that are not consecutive, frames per second."""


@dataclass(frozen=True)
class Clip:
    """T frames of motion.

    Attributes:
        name: What the page calls it.
        fps: Frames per second.
        frames: Source frame numbers, which the page shows.
        drives: What animates the head.
        cameras: What takes the picture; all of one size.
    """

    name: str
    fps: float
    frames: tuple[int, ...]
    drives: tuple[Drive, ...]
    cameras: tuple[Camera, ...]


def capture_clip(run: Run, which: str) -> Clip | None:
    """The test frames, the training frames or all frames of a run's capture; None for "none".

    Args:
        run: The run.
        which: A word of `CLIPS`, as `check_web_options` has checked.

    Raises:
        InputError: There is no such frame.
    """
    numbers = {"test": run.split.test, "train": run.split.train, "all": run.capture.frames, "none": ()}[which]
    if which == "none":
        return None
    if not numbers:
        raise InputError(f"{run.folder}: expected {which} frames for --clip {which}, found none; use --clip all")
    names = {"test": "test frames", "train": "training frames", "all": "all frames"}
    drives, cameras = zip(*((run.reader.drive(number), run.reader.camera(number)) for number in numbers), strict=True)
    return Clip(names[which], clip_rate(numbers, run.capture.fps), tuple(numbers), drives, cameras)


def clip_rate(frames: Sequence[int], fps: float) -> float:
    """The source's rate if its frames are consecutive; else at most `SPARSE_FPS`, since the page fills the gaps."""
    steps = np.diff(sorted(frames))
    return fps if len(steps) and float(np.median(steps)) == 1 else min(fps, SPARSE_FPS)


def clip_arrays(clip: Clip, torso_at_rest: Tensor) -> dict[str, np.ndarray]:
    """Arrays of T rows: parameters as they are, transforms as the twelve numbers of their upper three rows.

    Args:
        clip: The clip.
        torso_at_rest: Pose of the torso in frames without one.
    """
    if len(clip.frames) > MAX_CLIP_FRAMES:
        raise InputError(
            f"clip {clip.name!r}: expected at most {MAX_CLIP_FRAMES} frames, found {len(clip.frames)}; use a part of it"
        )
    drives, cameras = clip.drives, clip.cameras
    torso = [torso_at_rest if drive.torso_to_camera is None else drive.torso_to_camera for drive in drives]
    focal = [camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]] for camera in cameras]
    return {
        "expression": _rows([drive.expression for drive in drives]),
        "joint_rotations": _rows([drive.joint_rotations for drive in drives]),
        "eyelids": _rows([drive.eyelids for drive in drives]),
        "translation": _rows([drive.translation for drive in drives]),
        "head_to_camera": _rows([drive.head_to_camera[:3] for drive in drives]),
        "torso_to_camera": _rows([pose[:3] for pose in torso]),
        "world_to_camera": _rows([camera.world_to_camera[:3] for camera in cameras]),
        "intrinsics": _rows(focal),
    }


def _rows(values: Sequence[Tensor]) -> np.ndarray:
    return np.stack([value.detach().cpu().numpy().astype(np.float32).ravel() for value in values])
