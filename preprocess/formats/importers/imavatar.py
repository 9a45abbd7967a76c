"""The IMavatar family (PointAvatar, MonoGaussianAvatar too): flame_params.json, OpenGL cameras, lengths times four.

FLAME 2020 with 100 shape and 50 expression coefficients, the head posed by FLAME; frame numbers from 1; intrinsics as
parts of the image size with a negative focal length in x (older files: px of a 512 image).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.io.images import image_header
from ggavatar.io.json_files import read_json
from preprocess.formats.json_fields import array, camera_matrix, frame_list, last_number
from preprocess.formats.tracking_record import TrackingRecord, require_finite, stacked

TITLE = "IMavatar / PointAvatar / MonoGaussianAvatar: flame_params.json"
SCALE = 4.0
FLIP = np.diag([1.0, -1.0, -1.0])
OLD_SIZE = 512


def recognizes(folder: Path) -> bool:
    """Whether it is flame_params.json or a folder with it."""
    return _path(folder).is_file()


def _path(folder: Path) -> Path:
    return folder if folder.name == "flame_params.json" else folder / "flame_params.json"


def read(folder: Path) -> TrackingRecord:
    """Read cameras and FLAME parameters; `InputError` naming the file for anything wrong."""
    path = _path(folder)
    data = read_json(path)
    frames = {last_number(path, frame.get("file_path")): frame for frame in frame_list(path, data)}
    numbers = sorted(frames)
    width, height = _image_size(path.parent)
    poses, joints, expressions = zip(*(_frame(path, frames[step]) for step in numbers), strict=True)
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=width,
        height=height,
        intrinsics=np.tile(_intrinsics(path, data.get("intrinsics"), width, height), (len(numbers), 1, 1)),
        world_to_camera=np.stack(poses),
        expression=stacked(path, expressions, "expression coefficients"),
        joint_rotations=np.stack(joints),
        eyelids=np.zeros((len(numbers), 2)),
        translation=np.zeros((len(numbers), 3)),
        shape=array(path, data.get("shape_params"), (None,), "'shape_params'"),
        notes=("this format has no eyelids",),
    )
    return require_finite(path, record)


def _image_size(folder: Path) -> tuple[int, int]:
    """Size of the images beside the file; 512 × 512 if there are none (the intrinsics are relative anyway)."""
    for name in ("image", "images"):
        found = sorted((folder / name).glob("*.png")) if (folder / name).is_dir() else []
        if found:
            header = image_header(found[0])
            return header.width, header.height
    return OLD_SIZE, OLD_SIZE


def _intrinsics(path: Path, value: object, width: int, height: int) -> np.ndarray:
    """Pixels from parts of the image size; the sign of fx only says that the camera is OpenGL's."""
    values = array(path, value, (4,), "'intrinsics'")
    if values[3] > 1:
        values = values / OLD_SIZE
    if not (0.1 < abs(values[0]) < 100 and 0.1 < abs(values[1]) < 100):
        raise InputError(f"{path}: expected 'intrinsics' as parts of the image size, found {values.tolist()}")
    return camera_matrix(abs(values[0]) * width, abs(values[1]) * height, values[2] * width, values[3] * height)


def _frame(path: Path, frame: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World-to-camera, joint rotations and expression of one frame."""
    matrix = array(path, frame.get("world_mat"), (None, 4), "'world_mat'")
    if matrix.shape[0] not in (3, 4):
        raise InputError(f"{path}: expected 'world_mat' of shape (3, 4), found {matrix.shape}")
    pose = np.eye(4)
    pose[:3, :3] = FLIP @ matrix[:3, :3]
    pose[:3, 3] = FLIP @ matrix[:3, 3] / SCALE
    joints = array(path, frame.get("pose"), (15,), "'pose'").reshape(5, 3)
    return pose, joints, array(path, frame.get("expression"), (None,), "'expression'")


def write(folder: Path, record: TrackingRecord) -> None:
    """Write flame_params.json; frame numbers are shifted to start at 1, coefficients beyond 50 and 100 must be zero."""
    if np.any(record.expression[:, 50:]) or (record.shape is not None and np.any(record.shape[100:])):
        raise InputError("flame_params.json holds 50 expression and 100 identity coefficients; this tracking uses more")
    intrinsics = record.intrinsics[0]
    relative = [-intrinsics[0, 0] / record.width, intrinsics[1, 1] / record.height]
    relative += [intrinsics[0, 2] / record.width, intrinsics[1, 2] / record.height]
    first = int(record.numbers[0])
    shape = record.shape[:100] if record.shape is not None else np.zeros(100)
    content = {
        "frames": [_entry(record, row, step - first + 1) for row, step in enumerate(record.numbers.tolist())],
        "shape_params": np.pad(shape, (0, 100 - len(shape))).tolist(),
        "intrinsics": [float(value) for value in relative],
    }
    text = json.dumps(content, indent=1)
    write_text(_path(folder), text)


def _entry(record: TrackingRecord, row: int, step: int) -> dict[str, Any]:
    """One frame; the head's translation goes into the camera, where the format has it."""
    pose = record.world_to_camera[row]
    moved = pose[:3, :3] @ record.translation[row] + pose[:3, 3]
    expression = record.expression[row, :50]
    return {
        "file_path": f"./image/{step}",
        "world_mat": np.column_stack((FLIP @ pose[:3, :3], FLIP @ moved * SCALE)).tolist(),
        "expression": np.pad(expression, (0, 50 - len(expression))).tolist(),
        "pose": record.joint_rotations[row].ravel().tolist(),
        "bbox": [-1.0, -1.0, 1.0, 1.0],
    }
