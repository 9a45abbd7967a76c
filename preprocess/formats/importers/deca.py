"""DECA, EMOCA and SMIRK codes: per image a folder of npy files or an npz with shape, exp, pose, cam (SMIRK: eyelid).

Their camera is weak-perspective on a 224 px crop of the face. It is read as a distant camera with a long focal length,
which gives the same image but no metric distance: give the 224 px crops as INPUT, and prefer a tracker with a
perspective camera for training.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.json_fields import camera_matrix, last_number
from preprocess.formats.tracking_record import TrackingRecord, stacked, without_bad_frames

TITLE = "DECA / EMOCA / SMIRK codes: NAME.npz or NAME/{shape,exp,pose,cam}.npy"
SIDE = 224
FOCAL = 5000.0
"""Focal length that stands for weak perspective, px; a head at 5 m or more shows hardly any perspective."""

_KEYS = ("shape", "exp", "pose", "cam", "eyelid")
_SIZES = {"pose": 6, "cam": 3, "eyelid": 2}


def _entries(folder: Path) -> list[Path]:
    """One npz, or one folder of npy files, for every image."""
    if not folder.is_dir():
        return []
    archives = sorted(path for path in folder.glob("*.npz") if any(letter.isdigit() for letter in path.stem))
    folders = sorted(path for path in folder.iterdir() if path.is_dir() and (path / "exp.npy").is_file())
    return folders or archives


def recognizes(folder: Path) -> bool:
    """Whether the first entry has exp, pose and cam."""
    try:
        return bool(_entries(folder)) and {"exp", "pose", "cam"} <= set(_values(_entries(folder)[0]))
    except InputError:
        return False


def read(folder: Path) -> TrackingRecord:
    """Read all codes; `InputError` naming the file for anything wrong."""
    frames = {last_number(path, path.stem): _code(path) for path in _entries(folder)}
    if not frames:
        raise InputError(f"{folder}: expected {TITLE}; found no such files")
    numbers = sorted(frames)
    codes = [frames[number] for number in numbers]
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=SIDE,
        height=SIDE,
        intrinsics=np.tile(camera_matrix(FOCAL, FOCAL, SIDE / 2, SIDE / 2), (len(codes), 1, 1)),
        world_to_camera=np.stack([code["pose"] for code in codes]),
        expression=stacked(folder, [code["exp"] for code in codes], "expression coefficients"),
        joint_rotations=np.stack([code["joints"] for code in codes]),
        eyelids=np.stack([code["eyelid"] for code in codes]),
        translation=np.zeros((len(codes), 3)),
        shape=stacked(folder, [code["shape"] for code in codes], "identity coefficients").mean(axis=0),
        notes=("weak-perspective camera: distance and focal length are assumed", "the identity is the clip's mean"),
    )
    return without_bad_frames(folder, record)


def _values(path: Path) -> dict[str, np.ndarray]:
    """Arrays of one image."""
    if path.suffix == ".npz":
        return read_npz(path, _KEYS)
    found = {}
    for key in _KEYS:
        file = path / f"{key}.npy"
        if file.is_file():
            found[key] = _npy(file)
    return found


def _npy(path: Path) -> np.ndarray:
    if path.stat().st_size > 1 << 20:
        raise InputError(f"{path}: expected coefficients of at most 1 MiB, found {path.stat().st_size >> 20} MiB")
    try:
        value = np.load(path, allow_pickle=False, max_header_size=10_000)
    except (ValueError, EOFError, OSError, MemoryError) as error:
        raise InputError(f"{path}: expected an array of numbers ({error})") from error
    if not isinstance(value, np.ndarray):
        raise InputError(f"{path}: expected an array, found an archive")
    return value


def _code(path: Path) -> dict[str, Any]:
    """One image's code in our conventions."""
    values = _values(path)
    checked = {key: _checked(path, values, key) for key in _KEYS if key in values or key != "eyelid"}
    scale, shift_x, shift_y = checked["cam"]
    if not 0.01 < scale < 1000:
        raise InputError(f"{path}: expected a positive scale in 'cam', found {scale:g}")
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    # In the crop, x = s (X + tx) and y = −s (Y + ty), both in units of half its side.
    pose[:3, 3] = [shift_x, -shift_y, FOCAL / (scale * SIDE / 2)]
    joints = np.zeros((5, 3))
    joints[0], joints[2] = checked["pose"][:3], checked["pose"][3:]
    return {
        "pose": pose,
        "joints": joints,
        "exp": checked["exp"],
        "shape": checked["shape"],
        "eyelid": checked.get("eyelid", np.zeros(2)),
    }


def _checked(path: Path, values: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    value, size = values.get(key), _SIZES.get(key)
    if value is None or value.dtype.kind != "f" or not 1 <= value.size <= 1000 or (size and value.size != size):
        found = None if value is None else (str(value.dtype), value.shape)
        raise InputError(f"{path}: expected {key!r} with {size or 'up to 1000'} floating-point numbers, found {found}")
    return value.astype(np.float64).ravel()


def write(folder: Path, record: TrackingRecord) -> None:
    """Write one npz per image; `InputError` unless the cameras are weak-perspective as `read` gives them."""
    for row, number in enumerate(record.numbers.tolist()):
        pose, intrinsics = record.world_to_camera[row], record.intrinsics[row]
        if not np.allclose(pose[:3, :3], np.diag([1.0, -1.0, -1.0])) or (record.width, record.height) != (SIDE, SIDE):
            raise InputError(
                "DECA's codes hold only a static camera on 224 px crops; move the head pose into FLAME's root first"
            )
        scale = intrinsics[0, 0] / pose[2, 3] / (SIDE / 2)
        joints = record.joint_rotations[row]
        codes = {"cam": np.array([scale, pose[0, 3], -pose[1, 3]]), "pose": np.concatenate((joints[0], joints[2]))}
        codes |= {"exp": record.expression[row], "eyelid": record.eyelids[row]}
        codes["shape"] = record.shape if record.shape is not None else np.zeros(100)
        write_npz(folder / f"{number:05d}.npz", codes)
