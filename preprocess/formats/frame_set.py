"""Frames of a clip that are read one file at a time: what cannot be read is left out and said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from preprocess.formats.array_table import Assume
from preprocess.formats.tracking_record import MAX_BAD_SHARE, MAX_MAGNITUDE, TrackingRecord, left_out_text

Frame = Mapping[str, np.ndarray]
"""Arrays of one frame by name; "size", if there, is the (height, width) of its image."""


@dataclass(frozen=True)
class FrameSet:
    """The readable frames of a clip, all with arrays of the same shapes.

    Attributes:
        numbers: Frame numbers, ascending.
        frames: Arrays of each frame.
        notes: What was left out or assumed.
    """

    numbers: tuple[int, ...]
    frames: tuple[Frame, ...]
    notes: tuple[str, ...]

    def stacked(self, name: str) -> np.ndarray:
        """The array of that name of all frames."""
        return np.stack([frame[name] for frame in self.frames])

    def identity(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """The first frame's "shape", and a note if it changes."""
        shapes = self.stacked("shape")
        same = np.allclose(shapes, shapes[0], atol=1e-5, equal_nan=True)
        return shapes[0], () if same else ("the identity changes between frames; the first is used",)

    def record(self, notes: tuple[str, ...] = (), **others: Any) -> TrackingRecord:
        """The record of frames with "size" (height, width), "intrinsics", "world_to_camera" and so on.

        Args:
            notes: Notes besides those of the frames.
            **others: Fields of the record that are not stacked from the frames. Eyelids and translation that no frame
                has are zero.
        """
        height, width = self.stacked("size")[0]
        missing = {"eyelids": np.zeros((len(self.frames), 2)), "translation": np.zeros((len(self.frames), 3))}
        optional = {name: self.stacked(name) if name in self.frames[0] else zero for name, zero in missing.items()}
        stacked = {name: self.stacked(name) for name in ("intrinsics", "world_to_camera", "expression")}
        values = {**stacked, **optional, "joint_rotations": self.stacked("joint_rotations"), **others}
        return TrackingRecord(
            np.array(self.numbers, dtype=np.int64), int(width), int(height), notes=(*self.notes, *notes), **values
        )


Reader = Callable[[Assume], Frame]
"""Reads one frame."""


def read_frames(source: Path, files: Mapping[int, Path], read: Callable[[Path, Assume], Frame]) -> FrameSet:
    """Read one file for every frame; see `collect_frames`."""
    return collect_frames(source, {number: (path, partial(read, path)) for number, path in files.items()})


def read_rows(path: Path, count: int, read: Callable[[int, Assume], Frame]) -> FrameSet:
    """Read every row of one file, numbered from 0; see `collect_frames`."""
    return collect_frames(path, {row: (path, partial(read, row)) for row in range(count)})


def collect_frames(source: Path, readers: Mapping[int, tuple[Path, Reader]]) -> FrameSet:
    """Read all frames and keep those whose arrays have the shapes, and the size, that most frames have.

    Args:
        source: The folder, for messages.
        readers: The file that every frame comes from, for messages, and what reads it, by frame number.

    Raises:
        InputError: More than half of the frames cannot be used; the message is that of the first one.
    """
    frames: dict[int, Frame] = {}
    errors: dict[int, InputError] = {}
    assumed: Counter[str] = Counter()
    for number, (path, read) in readers.items():
        here: set[str] = set()
        try:
            frames[number] = _checked(path, read(here.add))
            assumed.update(here)
        except InputError as error:
            errors[number] = error
    usual = Counter(_signature(frame) for frame in frames.values()).most_common(1)
    for number in [number for number, frame in frames.items() if _signature(frame) != usual[0][0]]:
        errors[number] = InputError(
            f"{readers[number][0]}: expected the sizes of most other frames, found "
            f"{_signature_text(frames.pop(number))}; track the video in a single run"
        )
    if not frames or len(errors) > MAX_BAD_SHARE * len(readers):
        raise errors[min(errors)] if errors else InputError(f"{source}: expected frames, found none")
    numbers = tuple(sorted(frames))
    notes = [text if count == len(frames) else f"{text} (in {count} frames)" for text, count in assumed.items()]
    if errors:
        notes.insert(0, f"{left_out_text(list(errors), len(readers))}, the first since {errors[min(errors)]}")
    return FrameSet(numbers, tuple(frames[number] for number in numbers), tuple(notes))


def _checked(path: Path, frame: Frame) -> Frame:
    """The frame, unchanged; `InputError` if a number in it is not finite or larger than any that a portrait has."""
    for name, value in frame.items():
        if not (np.abs(value) < MAX_MAGNITUDE).all():
            raise InputError(
                f"{path}: {name} is NaN, infinite or above 10⁶ in magnitude; track the frame again or leave it out"
            )
    return frame


def _signature(frame: Frame) -> tuple[tuple[str, tuple[int, ...]], ...]:
    sizes = tuple(int(value) for value in frame["size"]) if "size" in frame else ()
    return (*((name, value.shape) for name, value in sorted(frame.items())), ("size", sizes))


def _signature_text(frame: Frame) -> str:
    size = f"images of {int(frame['size'][1])}×{int(frame['size'][0])} px, " if "size" in frame else ""
    return size + ", ".join(
        f"{name} {'×'.join(map(str, value.shape))}" for name, value in frame.items() if value.size > 3
    )
