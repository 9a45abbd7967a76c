"""IMavatar, PointAvatar and MonoGaussianAvatar: flame_params.json with OpenGL cameras and lengths times four.

FLAME 2020 with 100 shape and 50 expression coefficients, the head posed by FLAME; frame numbers from 1; intrinsics as
fractions of the image size with a negative focal length in x (in older files px of a 512 px image).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.images import image_header
from ggavatar.io.json_files import read_json, write_json
from preprocess.formats.json_fields import camera_matrix, frames_by_number, number_array
from preprocess.formats.tracking_record import TrackingRecord, stacked, without_bad_frames

TITLE = "IMavatar / PointAvatar / MonoGaussianAvatar: flame_params.json"
SCALE = 4.0
"""Length in the file over length in m."""
FLIP = np.diag([1.0, -1.0, -1.0])
"""OpenCV camera axes from OpenGL's."""
DEFAULT_SIZE = 512
"""Image side that older files assume, px."""


def recognizes(path: Path) -> bool:
    """Whether the path is flame_params.json or a folder that contains it."""
    return _json_file(path).is_file()


def _json_file(path: Path) -> Path:
    return path if path.name == "flame_params.json" else path / "flame_params.json"


def read(path: Path) -> TrackingRecord:
    """Read cameras and FLAME parameters; `InputError` naming the file for anything wrong."""
    path = _json_file(path)
    data = read_json(path)
    frames, name_notes = frames_by_number(path, data)
    numbers = sorted(frames)
    width, height = _image_size(path.parent)
    poses, joints, expressions = zip(*(_frame(path, frames[number]) for number in numbers), strict=True)
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
        shape=number_array(path, data.get("shape_params"), (None,), "'shape_params'"),
        notes=(*name_notes, "this format has no eyelids"),
    )
    return without_bad_frames(path, record)


def _image_size(folder: Path) -> tuple[int, int]:
    """Size of the images beside the file; 512 × 512 px without any, as the intrinsics are relative anyway."""
    for name in ("image", "images"):
        found = sorted((folder / name).glob("*.png")) if (folder / name).is_dir() else []
        if found:
            header = image_header(found[0])
            return header.width, header.height
    return DEFAULT_SIZE, DEFAULT_SIZE


def _intrinsics(path: Path, value: object, width: int, height: int) -> np.ndarray:
    """Intrinsics in px from fractions of the image size; the sign of fx only marks an OpenGL camera."""
    values = number_array(path, value, (4,), "'intrinsics'")
    if values[3] > 1:
        values = values / DEFAULT_SIZE
    if not (0.1 < abs(values[0]) < 100 and 0.1 < abs(values[1]) < 100):
        raise InputError(f"{path}: expected 'intrinsics' as fractions of the image size, found {values.tolist()}")
    return camera_matrix(abs(values[0]) * width, abs(values[1]) * height, values[2] * width, values[3] * height)


def _frame(path: Path, frame: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World-to-camera, joint rotations and expression of one frame."""
    matrix = number_array(path, frame.get("world_mat"), (None, 4), "'world_mat'")
    if matrix.shape[0] not in (3, 4):
        raise InputError(f"{path}: expected 'world_mat' of shape (3, 4) or (4, 4), found {matrix.shape}")
    pose = np.eye(4)
    pose[:3, :3] = FLIP @ matrix[:3, :3]
    pose[:3, 3] = FLIP @ matrix[:3, 3] / SCALE
    joints = number_array(path, frame.get("pose"), (15,), "'pose'").reshape(5, 3)
    return pose, joints, number_array(path, frame.get("expression"), (None,), "'expression'")


def write(path: Path, record: TrackingRecord) -> None:
    """Write flame_params.json; frame numbers are shifted to start at 1.

    Raises:
        InputError: Expression coefficients beyond 50 or identity coefficients beyond 100 are not zero.
    """
    if np.any(record.expression[:, 50:]) or (record.shape is not None and np.any(record.shape[100:])):
        raise InputError("flame_params.json holds 50 expression and 100 identity coefficients; this tracking uses more")
    intrinsics = record.intrinsics[0]
    relative = [-intrinsics[0, 0] / record.width, intrinsics[1, 1] / record.height]
    relative += [intrinsics[0, 2] / record.width, intrinsics[1, 2] / record.height]
    first = int(record.numbers[0])
    shape = record.shape[:100] if record.shape is not None else np.zeros(100)
    content = {
        "frames": [_entry(record, row, number - first + 1) for row, number in enumerate(record.numbers.tolist())],
        "shape_params": np.pad(shape, (0, 100 - len(shape))).tolist(),
        "intrinsics": [float(value) for value in relative],
    }
    write_json(_json_file(path), content)


def _entry(record: TrackingRecord, row: int, number: int) -> dict[str, Any]:
    """One frame; the head's translation goes into the camera, as the format has no other place for it."""
    pose = record.world_to_camera[row]
    moved = pose[:3, :3] @ record.translation[row] + pose[:3, 3]
    expression = record.expression[row, :50]
    return {
        "file_path": f"./image/{number}",
        "world_mat": np.column_stack((FLIP @ pose[:3, :3], FLIP @ moved * SCALE)).tolist(),
        "expression": np.pad(expression, (0, 50 - len(expression))).tolist(),
        "pose": record.joint_rotations[row].ravel().tolist(),
        "bbox": [-1.0, -1.0, 1.0, 1.0],
    }
