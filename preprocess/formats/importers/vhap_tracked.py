"""VHAP's own result, tracked_flame_params_*.npz, before its export: FLAME 2023 and one camera 1 m in front of the head.

The file holds all frames. Its camera is at (0, 0, 1), looks along −z and has one focal length, relative to the longer
side. Of calibrated clips (NeRSemble) the cameras are elsewhere: those are exported with VHAP first.
"""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.array_files import array_names
from preprocess.formats.array_table import ArrayTable
from preprocess.formats.importers.vhap import checked_offset
from preprocess.formats.json_fields import camera_matrix
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames

TITLE = "VHAP's tracked_flame_params_*.npz: one npz with rotation, translation, neck_pose, jaw_pose, eyes_pose, expr"
_NEEDED = frozenset({"rotation", "translation", "neck_pose", "jaw_pose", "eyes_pose", "expr", "shape"})
_MARKS = frozenset({"timestep_id", "n_processed_frames", "image_size"})
_KEYS = (*_NEEDED, *_MARKS, "focal_length", "static_offset")
_CAMERA = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
"""World-to-camera in OpenCV's axes of a camera at (0, 0, 1) that looks along −z."""


def recognizes(path: Path) -> bool:
    """Whether the npz has VHAP's parameters together with its time steps or image size."""
    return _file(path) is not None


def _file(path: Path) -> Path | None:
    for file in _candidates(path):
        names = array_names(file)
        if names >= _NEEDED and names & _MARKS:
            return file
    return None


def _candidates(path: Path) -> list[Path]:
    """The file itself, or the results in VHAP's output folder, the newest first."""
    if not path.is_dir():
        return [path]
    return sorted(path.glob("*.npz"), key=lambda file: (file.stat().st_mtime, file.name), reverse=True)[:100]


def read(path: Path) -> TrackingRecord:
    """Read all frames; those with numbers that are not finite are left out.

    Raises:
        InputError: Not such a file, or it has no focal length, as those of calibrated clips.
    """
    file = _file(path) or next(iter(_candidates(path)), path)
    notes: list[str] = [] if file == path else [f"{file.name} is read, the newest in the folder"]
    values = read_npz(file, _KEYS)
    table = ArrayTable(file, values, notes.append, batched=False)
    if "focal_length" not in values:
        raise InputError(
            f"{file}: expected 'focal_length', found none: the cameras of a calibrated clip are not in this file; give "
            "what `python vhap/export_as_nerf_dataset.py` writes"
        )
    height, width = _image_size(table)
    count = len(table.array(("expr",), (None, None)))
    rotations = [table.array((name,), (count, 3)) for name in ("rotation", "neck_pose", "jaw_pose")]
    focal = float(table.array(("focal_length",), (1,))[0]) * max(width, height)
    record = TrackingRecord(
        numbers=_numbers(file, values.get("timestep_id"), count, notes),
        width=width,
        height=height,
        intrinsics=np.tile(camera_matrix(focal, focal, width / 2, height / 2), (count, 1, 1)),
        world_to_camera=np.tile(_CAMERA, (count, 1, 1)),
        expression=table.array(("expr",), (count, None)),
        joint_rotations=np.concatenate(
            (np.stack(rotations, axis=1), table.array(("eyes_pose",), (count, 6)).reshape(count, 2, 3)), axis=1
        ),
        eyelids=np.zeros((count, 2)),
        translation=table.array(("translation",), (count, 3)),
        shape=table.array(("shape",), (None,)),
        version="flame2023",
        notes=tuple(notes),
        extra=checked_offset(file, values.get("static_offset")),
    )
    return without_bad_frames(file, record)


def _image_size(table: ArrayTable) -> tuple[int, int]:
    height, width = table.array(("image_size",), (2,)).tolist()
    if not all(1 <= side <= 16384 and side == round(side) for side in (height, width)):
        raise InputError(
            f"{table.path}: expected 'image_size' to be a height and width of 1 to 16384 px, found {height:g}, "
            f"{width:g}; track the video again"
        )
    return int(height), int(width)


def _numbers(path: Path, names: np.ndarray | None, count: int, notes: list[str]) -> np.ndarray:
    """Frame numbers from the names of the time steps, or 0, 1, 2, … if those are not ascending numbers."""
    texts = [] if names is None or names.size != count else [str(name) for name in names.reshape(-1)]
    digits = [re.findall(r"\d{1,9}", text) for text in texts]
    numbers = [int(found[-1]) for found in digits if found]
    if len(numbers) == count and all(low < high for low, high in pairwise(numbers)):
        return np.array(numbers, dtype=np.int64)
    notes.append("the names of the time steps are not ascending numbers: frames are counted from 0")
    return np.arange(count)


def write(path: Path, record: TrackingRecord) -> None:
    """Write one npz with all frames.

    Raises:
        InputError: The camera is not VHAP's, which the format cannot hold.
    """
    focal, center = record.intrinsics[:, [0, 1], [0, 1]], record.intrinsics[:, :2, 2]
    centered = np.allclose(center, [record.width / 2, record.height / 2], atol=1e-6)
    if not centered or np.ptp(focal) > 1e-6 or not np.allclose(record.world_to_camera, _CAMERA, atol=1e-6):
        raise InputError(
            "VHAP's own result holds only one camera 1 m in front of the head with the principal point at the center; "
            "move the head pose into FLAME and crop the images first"
        )
    joints, count = record.joint_rotations, len(record.numbers)
    shape = record.shape if record.shape is not None else np.zeros(300)
    offset = record.extra.get("static_offset")
    arrays = {
        "rotation": joints[:, 0],
        "translation": record.translation,
        "neck_pose": joints[:, 1],
        "jaw_pose": joints[:, 2],
        "eyes_pose": joints[:, 3:].reshape(count, 6),
        "shape": np.pad(shape, (0, max(0, 300 - len(shape)))),
        "expr": np.pad(record.expression, ((0, 0), (0, max(0, 100 - record.expression.shape[1])))),
        "timestep_id": np.array([f"{number:06d}" for number in record.numbers.tolist()]),
        "n_processed_frames": np.array(count),
        "focal_length": focal[:1, 0] / max(record.width, record.height),
        "image_size": np.array([record.height, record.width]),
    }
    write_npz(path, arrays | ({} if offset is None else {"static_offset": np.asarray(offset)[None]}))
