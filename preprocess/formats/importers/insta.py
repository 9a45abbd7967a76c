"""INSTA: transforms.json with camera-to-world matrices in OpenCV axes (not OpenGL, despite the NeRF-style file).

Expressions are in flame/exp/%05d.txt; published data sets also have flame/{jaw,eyes,eyelids,shape}. All frames share
one set of intrinsics.
"""

from __future__ import annotations

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
from ggavatar.io.inner_paths import path_inside
from ggavatar.io.json_files import read_json, write_json
from ggavatar.io.regular_files import read_file
from preprocess.formats.json_fields import (
    camera_matrix,
    finite_number,
    frames_by_number,
    image_size,
    invert_pose,
    number_array,
)
from preprocess.formats.tracking_record import TrackingRecord, stacked, without_bad_frames

WITHOUT_JAW = "no flame/jaw, so the jaw stays closed; give metrical-tracker's checkpoint folder instead"
"""Note on files of the version of INSTA that stores no jaw."""

TITLE = "INSTA: transforms.json with flame/exp/%05d.txt"


def recognizes(folder: Path) -> bool:
    """Whether the folder contains transforms.json and flame/exp."""
    return (folder / "transforms.json").is_file() and (folder / "flame" / "exp").is_dir()


def read(folder: Path) -> TrackingRecord:
    """Read cameras and FLAME parameters; `InputError` naming the file for anything wrong."""
    path = folder / "transforms.json"
    data = read_json(path)
    frames, name_notes = frames_by_number(path, data)
    numbers = sorted(frames)
    width, height = image_size(path, data)
    intrinsics = camera_matrix(*(finite_number(path, data, key) for key in ("fl_x", "fl_y", "cx", "cy")))
    matrices = [
        number_array(path, frames[number].get("transform_matrix"), (4, 4), "'transform_matrix'") for number in numbers
    ]
    coefficients = [_coefficients(path, frames[number], number) for number in numbers]
    has_jaw = (folder / "flame" / "jaw").is_dir()
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=width,
        height=height,
        intrinsics=np.tile(intrinsics, (len(numbers), 1, 1)),
        world_to_camera=np.stack([invert_pose(matrix) for matrix in matrices]),
        expression=stacked(path, [values["exp"] for values in coefficients], "expression coefficients"),
        joint_rotations=np.stack([values["joints"] for values in coefficients]),
        eyelids=np.stack([values["eyelids"] for values in coefficients]),
        translation=np.zeros((len(numbers), 3)),
        shape=coefficients[0]["shape"],
        notes=name_notes if has_jaw else (*name_notes, WITHOUT_JAW),
    )
    return without_bad_frames(folder, record)


def _coefficients(path: Path, frame: Mapping[str, Any], number: int) -> dict[str, Any]:
    """FLAME parameters of one frame from its text files."""
    expression = path_inside(path, frame.get("exp_path", f"flame/exp/{number:05d}.txt"))
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
    """Axis-angle rotations from 6D rows, or from axis-angle values as they are."""
    if values.size == 6 * count:
        return matrix_to_axis_angle(rotation_6d_to_matrix(torch.from_numpy(values.reshape(count, 6)))).numpy()
    if values.size == 3 * count:
        return values.reshape(count, 3)
    raise InputError(f"{path}: expected {6 * count} or {3 * count} numbers per file, found {values.size}")


def _text(path: Path, optional: bool = False) -> Any:
    """The numbers of a small text file; None if it is optional and missing."""
    if not path.is_file():
        if optional:
            return None
        raise InputError(f"{path}: no such file; expected the frame's coefficients in it")
    text = read_file(path, 1 << 20, "a text file with coefficients")
    try:
        return np.array([float(part) for part in text.decode("utf-8").split()], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: expected numbers separated by spaces or lines") from error


def write(folder: Path, record: TrackingRecord) -> None:
    """Write transforms.json, its splits (the last 350 frames test) and the text files.

    The format holds only one set of intrinsics: those of the first frame.

    Raises:
        InputError: The head is posed by FLAME's root, neck or translation, which the format cannot hold.
    """
    if np.abs(record.joint_rotations[:, :2]).max() > 1e-6 or np.abs(record.translation).max() > 1e-9:
        raise InputError(
            "INSTA's format has no root or neck rotation and no translation; move them into the camera first"
        )
    frames = [_frame(record, row, number) for row, number in enumerate(record.numbers.tolist())]
    for row, number in enumerate(record.numbers.tolist()):
        _write_coefficients(folder / "flame", record, row, number)
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
        write_json(folder / f"transforms{suffix}.json", shared | {"frames": part})


def _frame(record: TrackingRecord, row: int, number: int) -> dict[str, Any]:
    name = f"{number:05d}"
    return {
        "transform_matrix": invert_pose(record.world_to_camera[row]).tolist(),
        "file_path": f"images/{name}.png",
        "mesh_path": f"meshes/{name}.obj",
        "exp_path": f"flame/exp/{name}.txt",
        "depth_path": f"depth/{name}.png",
        "seg_mask_path": f"seg_mask/{name}.png",
    }


def _write_coefficients(folder: Path, record: TrackingRecord, row: int, number: int) -> None:
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
        write_text(folder / name / f"{number:05d}.txt", text)
