"""INSTA: transforms.json whose matrices are camera-to-world in OpenCV axes (no OpenGL, whatever the file looks like).

Expressions lie in flame/exp/%05d.txt; published data sets also have flame/{jaw,eyes,eyelids,shape}. One camera for
all frames.
"""

from __future__ import annotations

import json
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
from ggavatar.io.atomic import write_text
from ggavatar.io.json_files import read_json
from preprocess.formats.json_fields import (
    array,
    camera_matrix,
    frame_list,
    image_size,
    inside,
    invert,
    last_number,
    number,
)
from preprocess.formats.tracking_record import TrackingRecord, require_finite, stacked

TITLE = "INSTA: transforms.json with flame/exp/%05d.txt"


def recognizes(folder: Path) -> bool:
    """Whether transforms.json and flame/exp are there."""
    return (folder / "transforms.json").is_file() and (folder / "flame" / "exp").is_dir()


def read(folder: Path) -> TrackingRecord:
    """Read cameras and FLAME parameters; `InputError` naming the file for anything wrong."""
    path = folder / "transforms.json"
    data = read_json(path)
    frames = {last_number(path, frame.get("file_path")): frame for frame in frame_list(path, data)}
    numbers = sorted(frames)
    width, height = image_size(path, data)
    intrinsics = camera_matrix(*(number(path, data, key) for key in ("fl_x", "fl_y", "cx", "cy")))
    matrices = [array(path, frames[step].get("transform_matrix"), (4, 4), "'transform_matrix'") for step in numbers]
    coefficients = [_coefficients(path, frames[step], step) for step in numbers]
    has_jaw = (folder / "flame" / "jaw").is_dir()
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=width,
        height=height,
        intrinsics=np.tile(intrinsics, (len(numbers), 1, 1)),
        world_to_camera=np.stack([invert(matrix) for matrix in matrices]),
        expression=stacked(path, [values["exp"] for values in coefficients], "expression coefficients"),
        joint_rotations=np.stack([values["joints"] for values in coefficients]),
        eyelids=np.stack([values["eyelids"] for values in coefficients]),
        translation=np.zeros((len(numbers), 3)),
        shape=coefficients[0]["shape"],
        notes=()
        if has_jaw
        else ("there is no flame/jaw: the jaw stays closed; give metrical-tracker's checkpoint folder instead",),
    )
    return require_finite(folder, record)


def _coefficients(path: Path, frame: Mapping[str, Any], step: int) -> dict[str, Any]:
    """FLAME parameters of one frame from its text files."""
    expression = inside(path, frame.get("exp_path", f"flame/exp/{step:05d}.txt"))
    folder = expression.parent.parent
    joints = np.zeros((5, 3))
    jaw, eyes, lids, shape = (
        _text(folder / name / expression.name, optional=True) for name in ("jaw", "eyes", "eyelids", "shape")
    )
    if jaw is not None:
        joints[2:3] = _rotations(folder / "jaw", jaw, 1)
    if eyes is not None:
        joints[3:] = _rotations(folder / "eyes", eyes, 2)
    if lids is not None and lids.shape != (2,):
        raise InputError(f"{folder / 'eyelids' / expression.name}: expected 2 numbers, found {len(lids)}")
    return {
        "exp": _text(expression),
        "joints": joints,
        "eyelids": np.zeros(2) if lids is None else lids,
        "shape": shape,
    }


def _rotations(path: Path, values: np.ndarray, count: int) -> np.ndarray:
    """Axis-angle from 6D rows, or axis-angle as it is."""
    if values.size == 6 * count:
        return matrix_to_axis_angle(rotation_6d_to_matrix(torch.from_numpy(values.reshape(count, 6)))).numpy()
    if values.size == 3 * count:
        return values.reshape(count, 3)
    raise InputError(f"{path}: expected {6 * count} or {3 * count} numbers a file, found {values.size}")


def _text(path: Path, optional: bool = False) -> Any:
    """Numbers of a small text file; None if it may be absent and is."""
    if not path.is_file():
        if optional:
            return None
        raise InputError(f"{path}: no such file; it should hold the frame's coefficients")
    if path.stat().st_size > 1 << 20:
        raise InputError(f"{path}: more than 1 MiB of text for some coefficients")
    try:
        return np.array([float(part) for part in path.read_text(encoding="utf-8").split()], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: expected numbers separated by spaces or lines") from error


def write(folder: Path, record: TrackingRecord) -> None:
    """Write transforms.json, its splits (the last 350 test) and the text files.

    Only the first frame's intrinsics fit into the format.
    """
    if np.abs(record.joint_rotations[:, :2]).max() > 1e-6 or np.abs(record.translation).max() > 1e-9:
        raise InputError(
            "INSTA's format has no root or neck rotation and no translation; fold them into the camera first"
        )
    frames = [_frame(record, row, step) for row, step in enumerate(record.numbers.tolist())]
    for row, step in enumerate(record.numbers.tolist()):
        _write_coefficients(folder / "flame", record, row, step)
    intrinsics = record.intrinsics[0]
    angles = [
        2 * float(np.arctan(size / (2 * intrinsics[axis, axis])))
        for axis, size in enumerate((record.width, record.height))
    ]
    shared: dict[str, Any] = {"w": float(record.width), "h": float(record.height), "integer_depth_scale": 0.001}
    shared |= {"fl_x": float(intrinsics[0, 0]), "fl_y": float(intrinsics[1, 1])}
    shared |= {"cx": float(intrinsics[0, 2]), "cy": float(intrinsics[1, 2])}
    shared |= {"camera_angle_x": angles[0], "camera_angle_y": angles[1]}
    shared |= {"x_fov": float(np.degrees(angles[0])), "y_fov": float(np.degrees(angles[1]))}
    for suffix, part in {"": frames, "_train": frames[:-350], "_test": frames[-350:], "_val": frames[-20:]}.items():
        text = json.dumps(shared | {"frames": part}, indent=1)
        write_text(folder / f"transforms{suffix}.json", text)


def _frame(record: TrackingRecord, row: int, step: int) -> dict[str, Any]:
    name = f"{step:05d}"
    return {
        "transform_matrix": invert(record.world_to_camera[row]).tolist(),
        "file_path": f"images/{name}.png",
        "mesh_path": f"meshes/{name}.obj",
        "exp_path": f"flame/exp/{name}.txt",
        "depth_path": f"depth/{name}.png",
        "seg_mask_path": f"seg_mask/{name}.png",
    }


def _write_coefficients(folder: Path, record: TrackingRecord, row: int, step: int) -> None:
    rows = matrix_to_rotation_6d(axis_angle_to_matrix(torch.from_numpy(record.joint_rotations[row, 2:]))).numpy()
    shape = record.shape if record.shape is not None else np.zeros(300)
    parts = {
        "exp": record.expression[row],
        "jaw": rows[0],
        "eyes": rows[1:].ravel(),
        "eyelids": record.eyelids[row],
        "shape": shape,
    }
    for name, values in parts.items():
        text = "".join(f"{value:.9g}\n" for value in values)
        write_text(folder / name / f"{step:05d}.txt", text)
