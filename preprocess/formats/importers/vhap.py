"""VHAP's export, which GaussianAvatars reads: transforms.json with OpenGL cameras, one flame_param npz per timestep.

FLAME 2023; the head is posed by FLAME's own rotation and translation. Of several cameras, the first is read. Teeth and
per-frame offsets are left out; static offsets are kept for the head.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json, write_json
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.json_fields import (
    camera_matrix,
    finite_number,
    frame_list,
    image_size,
    number_array,
    path_inside,
    pose_from_opengl,
    pose_to_opengl,
)
from preprocess.formats.tracking_record import TrackingRecord, stacked, without_bad_frames

TITLE = "VHAP export / GaussianAvatars: transforms.json with flame_param/%05d.npz"
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
_SPLITS = ("transforms_train.json", "transforms_val.json", "transforms_test.json")


def recognizes(folder: Path) -> bool:
    """Whether the folder contains transforms.json (or one of its splits) and flame_param."""
    return (folder / "flame_param").is_dir() and any(
        (folder / name).is_file() for name in ("transforms.json", *_SPLITS)
    )


def read(folder: Path) -> TrackingRecord:
    """Read cameras and FLAME parameters; `InputError` naming the file for anything wrong."""
    frames, source = _frames(folder)
    camera = min((frame.get("camera_index", 0) for frame in frames), key=str)
    cameras = {str(frame.get("camera_index", 0)) for frame in frames}
    chosen = {_timestep(source, frame): frame for frame in frames if frame.get("camera_index", 0) == camera}
    numbers = sorted(chosen)
    width, height = image_size(source, chosen[numbers[0]])
    parameters = [_parameters(path_inside(source, chosen[timestep].get("flame_param_path"))) for timestep in numbers]
    notes = [f"camera {camera} of {len(cameras)} is used"] if len(cameras) > 1 else []
    if any(np.any(values["dynamic_offset"]) for values in parameters if "dynamic_offset" in values):
        notes.append("per-frame offsets of VHAP are left out")
    offset = parameters[0].get("static_offset")
    poses = [
        pose_from_opengl(number_array(source, chosen[number].get("transform_matrix"), (4, 4), "'transform_matrix'"))
        for number in numbers
    ]
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=width,
        height=height,
        intrinsics=np.stack([_intrinsics(source, chosen[number]) for number in numbers]),
        world_to_camera=np.stack(poses),
        expression=stacked(folder, [values["expr"].reshape(-1) for values in parameters], "expression coefficients"),
        joint_rotations=np.stack([_joints(values) for values in parameters]),
        eyelids=np.zeros((len(numbers), 2)),
        translation=np.stack([values["translation"].reshape(3) for values in parameters]),
        shape=parameters[0]["shape"].reshape(-1),
        version="flame2023",
        notes=tuple(notes),
        extra={"static_offset": offset[0]} if offset is not None and np.any(offset) else {},
    )
    return without_bad_frames(folder, record)


def _frames(folder: Path) -> tuple[list[Mapping[str, Any]], Path]:
    """All frames with the shared top-level values filled in, and the first file."""
    paths = (
        [folder / "transforms.json"] if (folder / "transforms.json").is_file() else [folder / name for name in _SPLITS]
    )
    frames: list[Mapping[str, Any]] = []
    for path in paths:
        if path.is_file():
            data = read_json(path)
            shared = {key: data[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy") if key in data}
            if data.get("frames"):
                frames += [shared | dict(frame) for frame in frame_list(path, data)]
    if not frames:
        raise InputError(f"{folder}: expected frames in transforms.json, found none; export the tracking again")
    return frames, paths[0]


def _timestep(path: Path, frame: Mapping[str, Any]) -> int:
    value = frame.get("timestep_index")
    if type(value) is not int or not 0 <= value < 1 << 31:
        raise InputError(f"{path}: expected 'timestep_index' to be a whole number, found {value!r:.60}")
    return value


def _intrinsics(path: Path, frame: Mapping[str, Any]) -> np.ndarray:
    return camera_matrix(*(finite_number(path, frame, key) for key in ("fl_x", "fl_y", "cx", "cy")))


def _parameters(path: Path) -> dict[str, np.ndarray]:
    """The arrays of one flame_param file as float64."""
    values = read_npz(path, _KEYS)
    sizes = {
        "translation": 3,
        "rotation": 3,
        "neck_pose": 3,
        "jaw_pose": 3,
        "eyes_pose": 6,
        "expr": None,
        "shape": None,
    }
    for key, size in sizes.items():
        found = values.get(key)
        if (
            found is None
            or found.dtype.kind != "f"
            or (size is not None and found.size != size)
            or not 1 <= found.size <= 1000
        ):
            shape = None if found is None else found.shape
            raise InputError(f"{path}: expected {key!r} with {size or 'up to 1000'} numbers, found {shape}")
    offset = values.get("static_offset")
    if offset is not None and (offset.ndim != 3 or offset.shape[::2] != (1, 3) or offset.dtype.kind != "f"):
        raise InputError(f"{path}: expected 'static_offset' of shape (1, V, 3), found {offset.shape}")
    return {key: value.astype(np.float64) for key, value in values.items()}


def _joints(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rotations of root, neck, jaw, left eye and right eye."""
    names = ("rotation", "neck_pose", "jaw_pose", "eyes_pose")
    return np.concatenate([values[name].reshape(-1, 3) for name in names])


def write(folder: Path, record: TrackingRecord) -> None:
    """Write transforms.json, its splits and flame_param as VHAP does: the first 70 % of the frames train.

    GaussianAvatars ignores the principal point: give it images with the principal point at the center.
    """
    (folder / "flame_param").mkdir(parents=True, exist_ok=True)
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
