"""metrical-tracker (Zielon): one `.frame` file per image, written by torch.save and read without executing code.

The head stays in FLAME's coordinates and the camera moves. Eyes are stored in FLAME's joint order; `img_size` is
(height, width). Files that others made from it are read too: with tensors or Parameters, without the batch axis, with
other names, with axis-angle instead of 6D rotations, or with PyTorch3D's `camera` alone.
"""

from __future__ import annotations

import dataclasses
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
from ggavatar.io.held_folders import make_folder
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_files import frame_content, frame_files, pickled_files
from preprocess.formats.frame_set import Frame, read_frames
from preprocess.formats.json_fields import camera_matrix
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames

TITLE = "metrical-tracker: folder of %05d.frame with the camera under 'opencv' or 'camera'"
_EXPRESSION = ("exp", "expression", "expr", "expcode", "expression_params")
_SHAPE = ("shape", "shapecode", "betas", "identity", "shape_params")
_EYELIDS = ("eyelids", "eyelid", "eyelid_params")
_JAW = ("jaw", "jaw_pose", "jawpose", "jaw_params")
_EYES = ("eyes", "eyes_pose", "eye_pose", "eye_pose_params")
_SIZE = ("img_size", "image_size", "size")
_CAMERAS = ("opencv", "camera")


def recognizes(folder: Path) -> bool:
    """Whether the folder, or `checkpoint` in it, contains pickled frames with FLAME's parameters and such a camera."""
    return bool(frame_files(folder, _accepts))


def _accepts(content: Mapping[str, Any]) -> bool:
    flame, camera = content.get("flame"), [content.get(name) for name in _CAMERAS]
    if not isinstance(flame, Mapping) or "R_rotation_matrix" in flame or {"R", "t"} <= set(flame):
        return False
    return any(isinstance(table, Mapping) and ("R" in table or "K" in table) for table in camera)


def read(folder: Path) -> TrackingRecord:
    """Read every `.frame` file of a folder; frames that cannot be read are left out.

    Raises:
        InputError: No such files, or most of them are damaged, hostile, incomplete, or contradict the others.
    """
    files = frame_files(folder, _accepts) or pickled_files(folder)
    if not files:
        raise InputError(f"{folder}: expected files such as 00000.frame; give metrical-tracker's `checkpoint` folder")
    frames = read_frames(folder, files, _read_frame)
    shape, notes = frames.identity()
    return without_bad_frames(folder, frames.record(notes, shape=shape))


def _read_frame(path: Path, assume: Assume) -> Frame:
    """The content of one file in our conventions."""
    content = ArrayTable(path, frame_content(path, "metrical-tracker's dictionary"), assume)
    flame = content.table(("flame",))
    if flame is None:
        raise InputError(f"{path}: expected metrical-tracker's dictionary with 'flame' in it; track the frame again")
    height, width = image_size(content)
    intrinsics, pose = _camera(content, width, height)
    eyes = flame.array(_EYES, (12,), (6,)).reshape(2, -1)
    joints = np.zeros((5, 3))
    joints[2:] = axis_angles_of(flame.array(_JAW, (6,), (3,)), *eyes)
    return {
        "size": np.array([height, width]),
        "intrinsics": intrinsics,
        "world_to_camera": pose,
        "expression": flame.array(_EXPRESSION, (None,)),
        "joint_rotations": joints,
        "eyelids": flame.array(_EYELIDS, (2,)) if flame.name_of(_EYELIDS) else np.zeros(2),
        "shape": flame.array(_SHAPE, (None,)),
    }


def image_size(content: ArrayTable) -> tuple[int, int]:
    """Height and width in px under `img_size`; `InputError` if they are no image size."""
    height, width = dataclasses.replace(content, batched=False).array(_SIZE, (2,)).tolist()
    if not all(1 <= size <= 16384 and size == round(size) for size in (height, width)):
        raise InputError(
            f"{content.path}: expected 'img_size' to be a height and width of 1 to 16384 px, found {height:g}, "
            f"{width:g}; track the frame again"
        )
    return int(height), int(width)


def axis_angles_of(*rotations: np.ndarray) -> np.ndarray:
    """Rotations of 6 numbers (two rows of their matrix) or of 3 (axis-angle) as rows of axis-angles, rad."""
    if all(rotation.size == 6 for rotation in rotations):  # one call of torch for all: it is called for every frame
        return matrix_to_axis_angle(rotation_6d_to_matrix(torch.from_numpy(np.stack(rotations)))).numpy()
    return np.stack([each if each.size == 3 else axis_angles_of(each)[0] for each in rotations])


def _camera(content: ArrayTable, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics and world-to-camera from `opencv`, or from PyTorch3D's `camera` where that is missing."""
    camera, pose = content.table(("opencv",)), np.eye(4)
    if camera is not None:
        pose[:3, :3] = camera.array(("R", "rotation"), (3, 3))
        pose[:3, 3] = camera.array(("t", "T", "translation"), (3,))
        return camera.array(("K", "intrinsics"), (3, 3)), pose
    camera = content.table(("camera",))
    if camera is None:
        raise InputError(f"{content.path}: expected 'opencv' or 'camera', found neither; track the frame again")
    content.assume("'opencv' is missing: the camera is taken from 'camera', as PyTorch3D defines it")
    rows = camera.array(("R", "rotation"), (6,), (3, 3))
    rotation = rows if rows.shape == (3, 3) else rotation_6d_to_matrix(torch.from_numpy(rows)).numpy()
    pose[:3, :3] = (rotation * np.array([-1.0, -1.0, 1.0])).T
    pose[:3, 3] = camera.array(("t", "T", "translation"), (3,)) * np.array([-1.0, -1.0, 1.0])
    focal = camera.array(("fl", "focal"), (1,), (2,))
    center = camera.array(("pp", "principal_point"), (2,)) if camera.name_of(("pp", "principal_point")) else np.zeros(2)
    half = min(width, height) / 2
    x, y = width / 2 - center[0] * half, height / 2 - center[1] * half
    return camera_matrix(focal[0] * half, focal[-1] * half, x, y), pose


def write(folder: Path, record: TrackingRecord) -> None:
    """Write metrical-tracker's `.frame` files, which FlashAvatar, INSTA and others read.

    Raises:
        InputError: The head is posed by FLAME's root, neck or translation, which the format cannot hold.
    """
    if np.abs(record.joint_rotations[:, :2]).max() > 1e-6 or np.abs(record.translation).max() > 1e-9:
        raise InputError(
            "metrical-tracker's format has no root or neck rotation and no translation; move them into the camera first"
        )
    make_folder(folder)
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
