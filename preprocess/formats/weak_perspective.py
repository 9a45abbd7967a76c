"""Codes of regressors (DECA, EMOCA, EMICA, SMIRK): FLAME parameters and a weak-perspective camera on a 224 px crop.

The camera is read as a distant one with a long focal length, which gives the same image but no metric distance.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.frame_names import frame_numbers
from preprocess.formats.array_files import array_names
from preprocess.formats.array_table import Assume
from preprocess.formats.frame_set import Frame, FrameSet, read_frames
from preprocess.formats.json_fields import camera_matrix
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames

SIDE = 224
FOCAL = 5000.0
"""Focal length that stands for weak perspective, px; a head at 5 m or more shows hardly any perspective."""

_MAX_ENTRIES = 200_000
_PROBES = 3


def code_places(folder: Path, needed: Collection[str]) -> dict[str, Path]:
    """Folders of npy files, or files of one suffix, by name, if one of their first three has all the needed arrays."""
    if not folder.is_dir():
        return {}
    groups: dict[str, dict[str, Path]] = {}
    for path in sorted(folder.iterdir())[:_MAX_ENTRIES]:
        if path.is_dir():
            groups.setdefault("/", {})[path.name] = path
        elif any(letter.isdigit() for letter in path.stem):
            groups.setdefault(path.suffix, {})[path.stem] = path
    for places in groups.values():
        if any(array_names(path) >= frozenset(needed) for path in list(places.values())[:_PROBES]):
            return places
    return {}


def read_codes(
    folder: Path, places: dict[str, Path], read: Callable[[Path, Assume], Frame]
) -> tuple[FrameSet, tuple[str, ...]]:
    """The codes of all images, and notes on their names."""
    found = frame_numbers(list(places), folder)
    names, notes = found.by_number(list(places)), found.notes
    return read_frames(folder, {number: places[name] for number, name in names.items()}, read), notes


def weak_pose(path: Path, camera: np.ndarray) -> np.ndarray:
    """World-to-camera of a weak-perspective camera (scale, tx, ty); `InputError` unless the scale is positive.

    x = s (X + tx) and y = −s (Y + ty) in units of half the crop's side.
    """
    scale, shift_x, shift_y = camera
    if not 0.01 < scale < 1000:
        raise InputError(f"{path}: expected a positive scale in 'cam', found {scale:g}; run the regressor again")
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [shift_x, -shift_y, FOCAL / (scale * SIDE / 2)]
    return pose


def weak_camera(record: TrackingRecord, row: int, tool: str) -> np.ndarray:
    """The inverse of `weak_pose`; `InputError` unless the frame has such a camera on a 224 px crop."""
    pose, intrinsics = record.world_to_camera[row], record.intrinsics[row]
    if not np.allclose(pose[:3, :3], np.diag([1.0, -1.0, -1.0])) or (record.width, record.height) != (SIDE, SIDE):
        raise InputError(
            f"{tool}'s codes hold only a static camera on 224 px crops; move the head pose into FLAME's root first"
        )
    return np.array([intrinsics[0, 0] / pose[2, 3] / (SIDE / 2), pose[0, 3], -pose[1, 3]])


def weak_record(
    source: Path, frames: FrameSet, notes: tuple[str, ...] = (), version: str = "flame2020"
) -> TrackingRecord:
    """The record of frames with "pose", "joints", "expression", "eyelids" and "shape"; the identity is their mean."""
    count = len(frames.numbers)
    record = TrackingRecord(
        numbers=np.array(frames.numbers, dtype=np.int64),
        width=SIDE,
        height=SIDE,
        intrinsics=np.tile(camera_matrix(FOCAL, FOCAL, SIDE / 2, SIDE / 2), (count, 1, 1)),
        world_to_camera=frames.stacked("pose"),
        expression=frames.stacked("expression"),
        joint_rotations=frames.stacked("joints"),
        eyelids=frames.stacked("eyelids"),
        translation=np.zeros((count, 3)),
        shape=frames.stacked("shape").mean(axis=0),
        version=version,
        camera_is_assumed=True,
        notes=(
            *frames.notes,
            *notes,
            "weak-perspective camera: distance and focal length are assumed",
            "the identity is the clip's mean",
        ),
    )
    return without_bad_frames(source, record)
