"""VHAP's export, which GaussianAvatars reads: transforms.json with OpenGL cameras, one flame_param npz per timestep.

FLAME 2023; the head is posed by FLAME's own rotation and translation. Of several cameras, the first is read. Teeth and
per-frame offsets are left out; static offsets are kept for the head. Combined data sets (UNION folders) list files of
the sequences beside them, `../SEQUENCE/…`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.held_folders import make_folder
from ggavatar.io.inner_paths import path_inside
from ggavatar.io.json_files import read_json, write_json
from ggavatar.io.npz import read_npz, write_npz
from ggavatar.io.regular_files import read_start
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_set import Frame, collect_frames
from preprocess.formats.json_fields import (
    camera_matrix,
    finite_number,
    frame_list,
    image_size,
    number_array,
    pose_from_opengl,
    pose_to_opengl,
)
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames
from preprocess.video.listed_images import first_camera, list_files

TITLE = "VHAP export, UNION / GaussianAvatars: transforms.json that lists flame_param/%05d.npz"
_KEYS = (
    "translation",
    "rotation",
    "neck_pose",
    "jaw_pose",
    "eyes_pose",
    "expr",
    "shape",
    "static_offset",
    "dynamic_offset",
)
_MARK = b'"flame_param_path"'
_HEAD_BYTES = 1 << 22


def recognizes(folder: Path) -> bool:
    """Whether transforms.json (or one of its splits) in the folder lists files of FLAME parameters."""
    return any(_lists_parameters(path) for path in list_files(folder))


def _lists_parameters(path: Path) -> bool:
    return path.is_file() and _MARK in read_start(path, _HEAD_BYTES)


def read(folder: Path) -> TrackingRecord:
    """Read cameras and FLAME parameters; frames whose parameters cannot be read are left out.

    Raises:
        InputError: No frames, most of them cannot be read, or a listed file lies outside of the data set.
    """
    listed = _frames(folder)
    camera = first_camera([frame for _, frame in listed])
    cameras = {str(frame.get("camera_index", 0)) for _, frame in listed}
    chosen = {_timestep(path, frame): (path, frame) for path, frame in listed if frame.get("camera_index", 0) == camera}
    files = {
        number: path_inside(path, frame.get("flame_param_path"), siblings=True)
        for number, (path, frame) in chosen.items()
    }
    readers = {number: (file, partial(_read_entry, *chosen[number], file)) for number, file in sorted(files.items())}
    frames = collect_frames(folder, readers)
    notes = (f"camera {camera} of {len(cameras)} is used",) if len(cameras) > 1 else ()
    record = frames.record(
        notes,
        shape=frames.frames[0]["shape"],
        version="flame2023",
        extra=_static_offset(files[frames.numbers[0]]),
    )
    return without_bad_frames(folder, record)


def _read_entry(path: Path, entry: Mapping[str, Any], file: Path, assume: Assume) -> Frame:
    """One frame in our conventions."""
    values = parameters(file, assume)
    width, height = image_size(path, entry)
    pose = number_array(path, entry.get("transform_matrix"), (4, 4), "'transform_matrix'")
    return values | {
        "size": np.array([height, width]),
        "intrinsics": camera_matrix(*(finite_number(path, entry, key) for key in ("fl_x", "fl_y", "cx", "cy"))),
        "world_to_camera": pose_from_opengl(pose),
    }


def _frames(folder: Path) -> list[tuple[Path, Mapping[str, Any]]]:
    """All frames with the shared top-level values filled in, each with the file that lists it."""
    frames: list[tuple[Path, Mapping[str, Any]]] = []
    for path in list_files(folder):
        data = read_json(path)
        shared = {key: data[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy") if key in data}
        if data.get("frames"):
            frames += [(path, shared | dict(frame)) for frame in frame_list(path, data)]
    if not frames:
        raise InputError(f"{folder}: expected frames in transforms.json, found none; export the tracking again")
    return frames


def _timestep(path: Path, frame: Mapping[str, Any]) -> int:
    value = frame.get("timestep_index")
    if type(value) is not int or not 0 <= value < 1 << 31:
        raise InputError(f"{path}: expected 'timestep_index' to be a whole number, found {value!r:.60}")
    return value


def parameters(path: Path, assume: Assume) -> dict[str, np.ndarray]:
    """The arrays of one flame_param file in our conventions; `InputError` if one is missing or of another size."""
    values = read_npz(path, _KEYS)
    if np.any(values.pop("dynamic_offset", 0)):
        assume("per-frame offsets of VHAP are left out")
    values.pop("static_offset", None)
    table = ArrayTable(path, {key: value.reshape(-1) for key, value in values.items()}, assume, batched=False)
    rotations = [table.array((name,), (3,)) for name in ("rotation", "neck_pose", "jaw_pose")]
    eyes = table.array(("eyes_pose",), (6,)).reshape(2, 3)
    return {
        "expression": table.array(("expr",), (None,)),
        "joint_rotations": np.concatenate((np.stack(rotations), eyes)),
        "translation": table.array(("translation",), (3,)),
        "shape": table.array(("shape",), (None,)),
    }


def _static_offset(path: Path) -> dict[str, np.ndarray]:
    """VHAP's static per-vertex offsets in a file, for `TrackingRecord.extra`; empty if there are none."""
    return checked_offset(path, read_npz(path, ["static_offset"]).get("static_offset"))


def checked_offset(path: Path, offset: np.ndarray | None) -> dict[str, np.ndarray]:
    """Static offsets of shape (1, V, 3) as an entry of `TrackingRecord.extra`; `InputError` for other arrays."""
    if offset is None or not np.any(offset):
        return {}
    if offset.ndim != 3 or offset.shape[::2] != (1, 3) or offset.dtype.kind != "f" or not np.isfinite(offset).all():
        raise InputError(
            f"{path}: expected finite numbers of shape (1, V, 3) in 'static_offset', found {offset.shape}; export the "
            "tracking again"
        )
    return {"static_offset": offset[0].astype(np.float64)}


def write(folder: Path, record: TrackingRecord) -> None:
    """Write transforms.json, its splits and flame_param as VHAP does: the first 70 % of the frames train.

    GaussianAvatars ignores the principal point: give it images with the principal point at the center.
    """
    make_folder(folder / "flame_param")
    offset = record.extra.get("static_offset")
    static = np.zeros((1, 5143, 3), np.float32) if offset is None else np.asarray(offset, np.float32)[None]
    frames = []
    for row, number in enumerate(record.numbers.tolist()):
        write_npz(folder / "flame_param" / f"{number:05d}.npz", _flame_arrays(record, row, static))
        frames.append(_frame(record, row, number))
    still = {
        key: np.zeros_like(value) if key in _STILL else value for key, value in _flame_arrays(record, 0, static).items()
    }
    write_npz(folder / "canonical_flame_param.npz", still | {"jaw_pose": np.array([[0.3, 0, 0]])})
    train = -(-7 * len(frames) // 10)
    parts = {
        "": frames,
        "_backup": frames,
        "_backup_flame": frames,
        "_train": frames[:train],
        "_val": [],
        "_test": frames[train:],
    }
    for suffix, part in parts.items():
        shared = {"timestep_indices": record.numbers.tolist(), "camera_indices": [0]}
        write_json(folder / f"transforms{suffix}.json", {"frames": part} | shared)


_STILL = frozenset({"translation", "rotation", "neck_pose", "eyes_pose", "expr"})


def _flame_arrays(record: TrackingRecord, row: int, static: np.ndarray) -> dict[str, np.ndarray]:
    joints = record.joint_rotations[row]
    shape = record.shape if record.shape is not None else np.zeros(300)
    return {
        "translation": record.translation[row][None],
        "rotation": joints[0][None],
        "neck_pose": joints[1][None],
        "jaw_pose": joints[2][None],
        "eyes_pose": joints[3:].reshape(1, 6),
        "shape": np.pad(shape, (0, max(0, 300 - len(shape)))),
        "expr": np.pad(record.expression[row], (0, max(0, 100 - record.expression.shape[1])))[None],
        "static_offset": static,
    }


def _frame(record: TrackingRecord, row: int, number: int) -> dict[str, Any]:
    """One entry of transforms.json."""
    intrinsics = record.intrinsics[row]
    focal = intrinsics[[0, 1], [0, 1]]
    angles = 2 * np.arctan(np.array([record.width, record.height]) / (2 * focal))
    return {
        "timestep_index": number,
        "timestep_index_original": number,
        "timestep_id": f"{number:05d}",
        "camera_index": 0,
        "camera_id": "0",
        "cx": float(intrinsics[0, 2]),
        "cy": float(intrinsics[1, 2]),
        "fl_x": float(focal[0]),
        "fl_y": float(focal[1]),
        "w": record.width,
        "h": record.height,
        "camera_angle_x": float(angles[0]),
        "camera_angle_y": float(angles[1]),
        "transform_matrix": pose_to_opengl(record.world_to_camera[row]).tolist(),
        "file_path": f"images/{number:05d}_00.png",
        "fg_mask_path": f"fg_masks/{number:05d}_00.png",
        "flame_param_path": f"flame_param/{number:05d}.npz",
    }
