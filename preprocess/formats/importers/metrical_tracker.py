"""metrical-tracker (Zielon): one `.frame` file per image, written by torch.save and read without executing code.

The head stays in FLAME's coordinates and the camera moves. Eyes are stored in FLAME's joint order; `img_size` is
(height, width).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ggavatar.errors import InputError
from ggavatar.geometry.transforms import (
    axis_angle_to_matrix,
    matrix_to_axis_angle,
    matrix_to_rotation_6d,
    rotation_6d_to_matrix,
)
from ggavatar.io.restricted_pickle import read_pickle
from preprocess.formats.tracking_record import TrackingRecord, require_finite, stacked

TITLE = "metrical-tracker: folder of %05d.frame"
_NAME = re.compile(r"^(\d{1,9})\.frame$")


def recognizes(folder: Path) -> bool:
    """Whether the folder, or `checkpoint` in it, contains `.frame` files."""
    return bool(_files(folder))


def _files(folder: Path) -> dict[int, Path]:
    """Frame files by number, from the folder or from `checkpoint` in it."""
    for place in (folder, folder / "checkpoint"):
        if place.is_dir():
            found = {int(match[1]): path for path in place.iterdir() if (match := _NAME.match(path.name))}
            if found:
                return dict(sorted(found.items()))
    return {}


def read(folder: Path) -> TrackingRecord:
    """Read every `.frame` file of a folder.

    Raises:
        InputError: No such files, or a file is damaged, hostile, incomplete, or contradicts the others.
    """
    files = _files(folder)
    if not files:
        raise InputError(f"{folder}: expected files such as 00000.frame; give metrical-tracker's `checkpoint` folder")
    frames = [_read_frame(path) for path in files.values()]
    height, width = frames[0]["size"]
    for path, frame in zip(files.values(), frames, strict=True):
        if frame["size"] != (height, width):
            raise InputError(
                f"{path}: expected img_size {(height, width)} as in the first file, found {frame['size']}; track the "
                "video in a single run"
            )
    shapes = stacked(folder, [frame["shape"] for frame in frames], "identity coefficients")
    notes = (
        () if np.allclose(shapes, shapes[0], atol=1e-5) else ("the identity changes between frames; the first is used",)
    )
    arrays = {name: stacked(folder, [frame[name] for frame in frames], name) for name in frames[0] if name != "size"}
    record = TrackingRecord(
        numbers=np.array(list(files), dtype=np.int64),
        width=width,
        height=height,
        intrinsics=arrays["intrinsics"],
        world_to_camera=arrays["world_to_camera"],
        expression=arrays["expression"],
        joint_rotations=arrays["joint_rotations"],
        eyelids=arrays["eyelids"],
        translation=arrays["translation"],
        shape=shapes[0],
        notes=notes,
    )
    return require_finite(folder, record)


def _read_frame(path: Path) -> dict[str, Any]:
    """The content of one file in our conventions."""
    content = read_pickle(path)
    flame, camera = _table(path, content, "flame"), _table(path, content, "opencv")
    size = np.asarray(content.get("img_size"))
    if size.shape != (2,) or size.dtype.kind not in "iu" or not (size.min() >= 1 and size.max() <= 16384):
        raise InputError(f"{path}: expected 'img_size' to be (height, width), found {content.get('img_size')!r:.60}")
    pose = np.eye(4)
    pose[:3, :3] = _array(path, camera, "R", (3, 3))
    pose[:3, 3] = _array(path, camera, "t", (3,))
    eyes = _array(path, flame, "eyes", (12,))
    rotations = torch.from_numpy(np.stack([_array(path, flame, "jaw", (6,)), eyes[:6], eyes[6:]]))
    joints = np.zeros((5, 3))
    joints[2:] = matrix_to_axis_angle(rotation_6d_to_matrix(rotations)).numpy()
    lids = _array(path, flame, "eyelids", (2,)) if "eyelids" in flame else np.zeros(2)
    return {
        "size": (int(size[0]), int(size[1])),
        "intrinsics": _array(path, camera, "K", (3, 3)),
        "world_to_camera": pose,
        "expression": _array(path, flame, "exp", (None,)),
        "joint_rotations": joints,
        "eyelids": lids,
        "translation": np.zeros(3),
        "shape": _array(path, flame, "shape", (None,)),
    }


def _table(path: Path, content: object, key: str) -> Mapping[str, Any]:
    inside = content.get(key) if isinstance(content, Mapping) else None
    if not isinstance(inside, Mapping):
        raise InputError(f"{path}: expected metrical-tracker's dictionary with {key!r} in it")
    return inside


def _array(path: Path, table: Mapping[str, Any], key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """An array of the table as float64 without its leading batch axis of size 1."""
    value = table.get(key)
    if (
        isinstance(value, np.ndarray)
        and value.dtype.kind == "f"
        and value.ndim == len(shape) + 1
        and value.shape[0] == 1
    ):
        value = value[0]
        if all(want in (None, size) for want, size in zip(shape, value.shape, strict=True)):
            return value.astype(np.float64)
    found = value.shape if isinstance(value, np.ndarray) else type(value).__name__
    raise InputError(
        f"{path}: expected {key!r} as a floating-point array of shape (1, {', '.join(map(str, shape))}), found {found}"
    )


def write(folder: Path, record: TrackingRecord) -> None:
    """Write metrical-tracker's `.frame` files, which FlashAvatar, INSTA and others read.

    Raises:
        InputError: The head is posed by FLAME's root, neck or translation, which the format cannot hold.
    """
    if np.abs(record.joint_rotations[:, :2]).max() > 1e-6 or np.abs(record.translation).max() > 1e-9:
        raise InputError(
            "metrical-tracker's format has no root or neck rotation and no translation; move them into the camera first"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for row, number in enumerate(record.numbers):
        torch.save(frame_dictionary(record, row), folder / f"{int(number):05d}.frame")


def frame_dictionary(record: TrackingRecord, row: int) -> dict[str, Any]:
    """The content of one `.frame` file: row `row` of the record."""
    joints = torch.from_numpy(record.joint_rotations[row])
    rows = matrix_to_rotation_6d(axis_angle_to_matrix(joints)).numpy()
    pose, intrinsics = record.world_to_camera[row], record.intrinsics[row]
    flame = {
        "exp": _padded(record.expression[row], 100),
        "shape": _padded(record.shape if record.shape is not None else np.zeros(0), 300),
        "tex": np.zeros(140),
        "sh": np.zeros((9, 3)),
        "eyes": rows[3:5].reshape(-1),
        "eyelids": record.eyelids[row],
        "jaw": rows[2],
    }
    opencv = {"R": pose[:3, :3], "t": pose[:3, 3], "K": intrinsics}
    return {
        "flame": _batched(flame),
        "camera": _batched(_pytorch3d(pose, intrinsics, record.width, record.height)),
        "opencv": _batched(opencv),
        "img_size": np.array([record.height, record.width]),
        "frame_id": f"{int(record.numbers[row]):05d}",
        "global_step": 0,
    }


def _batched(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.asarray(value, dtype=np.float32)[None] for name, value in arrays.items()}


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.pad(values, (0, max(0, size - len(values))))


def _pytorch3d(pose: np.ndarray, intrinsics: np.ndarray, width: int, height: int) -> dict[str, np.ndarray]:
    """The same camera in PyTorch3D's NDC: row vectors, +X left, +Y up; lengths in units of half the shorter side."""
    half = min(width, height) / 2
    rotation = pose[:3, :3].T * np.array([-1.0, -1.0, 1.0])
    center = np.array([width / 2 - intrinsics[0, 2], height / 2 - intrinsics[1, 2]]) / half
    return {
        "R": rotation[:2].reshape(-1),
        "t": pose[:3, 3] * np.array([-1.0, -1.0, 1.0]),
        "fl": intrinsics[:1, 0] / half,
        "pp": center,
    }
