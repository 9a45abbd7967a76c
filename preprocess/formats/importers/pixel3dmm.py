"""Pixel3DMM (Giebenhain): one `.frame` file per image of a static square crop; FLAME is posed outside of its skinning.

The head is FLAME with an identity root, then X = R·v + t about the origin, which is folded into the camera. The crop is
`cropped/%05d.jpg` of its preprocessing; `img_size` is the size that was optimized at. FLAME 2020, unless it was tracked
with `use_flame2023`, which means the variant without jaw and is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ggavatar.errors import InputError
from ggavatar.geometry.transforms import axis_angle_to_matrix, matrix_to_rotation_6d, rotation_6d_to_matrix
from ggavatar.io.held_folders import make_folder
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_files import frame_content, frame_files, pickled_files
from preprocess.formats.frame_set import Frame, read_frames
from preprocess.formats.importers.metrical_tracker import axis_angles_of, image_size
from preprocess.formats.json_fields import camera_matrix
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames

TITLE = "Pixel3DMM: folder of %05d.frame with the head's rotation under 'flame'"
OPENGL = np.diag([1.0, -1.0, -1.0])
"""Turns OpenGL's camera axes (y up, z backwards) into OpenCV's."""

MAX_FRAMES = 1000
"""Pixel3DMM tracks no more frames of a video."""

_NECK_NOTE = 0.05
"""Rotation of the neck, rad, above which the different order of lids and skinning is worth a note."""


def recognizes(folder: Path) -> bool:
    """Whether the folder, or `checkpoint` in it, contains pickled frames with FLAME's own rotation and translation."""
    return bool(frame_files(folder, _accepts))


def _accepts(content: Mapping[str, Any]) -> bool:
    flame, camera = content.get("flame"), content.get("camera")
    if not isinstance(flame, Mapping) or not isinstance(camera, Mapping):
        return False
    return "t" in flame and bool({"R", "R_rotation_matrix"} & set(flame)) and "R_base_0" in camera


def read(folder: Path) -> TrackingRecord:
    """Read every `.frame` file of a folder; frames that cannot be read are left out.

    Raises:
        InputError: No such files, most of them cannot be used, or the jaw never moves (FLAME 2023 without jaw).
    """
    files = frame_files(folder, _accepts) or pickled_files(folder)
    if not files:
        raise InputError(f"{folder}: expected files such as 00000.frame; give Pixel3DMM's `checkpoint` folder")
    frames = read_frames(folder, files, _read_frame)
    joints = frames.stacked("joint_rotations")
    if len(joints) > 1 and not joints[:, 2].any():
        raise InputError(
            f"{folder}: expected a jaw that moves, found one that is exactly closed in all {len(joints)} frames, as "
            "with use_flame2023=True, whose FLAME has no jaw; track the video again with use_flame2023=False"
        )
    shape, notes = frames.identity()
    notes = (*notes, *_notes(joints, frames.stacked("eyelids")))
    return without_bad_frames(folder, frames.record(notes, shape=shape))


def _notes(joints: np.ndarray, lids: np.ndarray) -> tuple[str, ...]:
    notes = ["Pixel3DMM's cameras belong to its own crop: INPUT is the folder `cropped` of its preprocessing"]
    if np.abs(joints[:, 1]).max() > _NECK_NOTE and np.abs(lids).max() > 0.01:
        notes.append("Pixel3DMM adds the eyelids without the neck's rotation; they are rotated with it here")
    if len(joints) == MAX_FRAMES:
        notes.append(f"Pixel3DMM stops after {MAX_FRAMES} frames; a longer video has no tracking beyond")
    return tuple(notes)


def _read_frame(path: Path, assume: Assume) -> Frame:
    """The content of one file in our conventions."""
    content = ArrayTable(path, frame_content(path, "Pixel3DMM's dictionary"), assume)
    flame, camera = content.table(("flame",)), content.table(("camera",))
    if flame is None or camera is None:
        raise InputError(f"{path}: expected Pixel3DMM's dictionary with 'flame' and 'camera'; track the frame again")
    height, width = image_size(content)
    if height != width:
        raise InputError(f"{path}: expected a square crop in 'img_size', found {width}×{height} px; track it again")
    eyes = flame.array(("eyes",), (12,)).reshape(2, 6)
    joints = np.zeros((5, 3))
    joints[1:] = axis_angles_of(*(flame.array((k,), (6,)) for k in ("neck", "jaw")), *eyes)
    focal = float(camera.array(("fl",), (1,))[0]) * width
    center = (camera.array(("pp",), (2,)) + 1) * (width / 2 + 0.5)
    return {
        "size": np.array([height, width]),
        "intrinsics": camera_matrix(focal, focal, *center),
        "world_to_camera": _pose(path, flame, camera),
        "expression": flame.array(("exp",), (None,)),
        "joint_rotations": joints,
        "eyelids": flame.array(("eyelids",), (2,)) if "eyelids" in flame.values else np.zeros(2),
        "shape": flame.array(("shape",), (None,)),
    }


def _pose(path: Path, flame: ArrayTable, camera: ArrayTable) -> np.ndarray:
    """World-to-camera with the head's rotation and translation folded in."""
    if "R" in flame.values:
        turn = rotation_6d_to_matrix(torch.from_numpy(flame.array(("R",), (6,)))).numpy()
    else:
        turn = flame.array(("R_rotation_matrix",), (3, 3))
    stored = flame.array(("R_rotation_matrix",), (3, 3)) if "R_rotation_matrix" in flame.values else turn
    if np.abs(stored - turn).max() > 1e-3:
        raise InputError(f"{path}: expected 'R' and 'R_rotation_matrix' to agree; track the frame again")
    base, offset = camera.array(("R_base_0",), (3, 3)), camera.array(("t_base_0",), (3,))
    pose = np.eye(4)
    pose[:3, :3] = OPENGL @ base @ turn
    pose[:3, 3] = OPENGL @ (base @ flame.array(("t",), (3,)) + offset)
    return pose


def write(folder: Path, record: TrackingRecord) -> None:
    """Write Pixel3DMM's `.frame` files.

    Raises:
        InputError: The images are not square, the focal lengths differ, or the head is posed by FLAME's root or
            translation, which the format cannot hold.
    """
    if np.abs(record.joint_rotations[:, 0]).max() > 1e-6 or np.abs(record.translation).max() > 1e-9:
        raise InputError("Pixel3DMM's format has no root rotation and no translation; move them into the camera first")
    focal = record.intrinsics[:, [0, 1], [0, 1]]
    if record.width != record.height or not np.allclose(focal[:, 0], focal[:, 1], rtol=1e-6):
        raise InputError("Pixel3DMM's format holds only square images with one focal length; crop the images first")
    make_folder(folder)
    for row, number in enumerate(record.numbers.tolist()):
        torch.save(_dictionary(record, row), folder / f"{number:05d}.frame")


def _dictionary(record: TrackingRecord, row: int) -> dict[str, Any]:
    pose, size = OPENGL @ record.world_to_camera[row][:3], record.width
    rows = matrix_to_rotation_6d(axis_angle_to_matrix(torch.from_numpy(record.joint_rotations[row]))).numpy()
    shape = record.shape if record.shape is not None else np.zeros(300)
    base = np.array([0.0, 0.0, -1.0])
    arrays = {
        "flame": {
            "shape": np.pad(shape, (0, max(0, 300 - len(shape)))),
            "exp": np.pad(record.expression[row], (0, max(0, 100 - record.expression.shape[1]))),
            "neck": rows[1],
            "jaw": rows[2],
            "eyes": rows[3:].reshape(-1),
            "eyelids": record.eyelids[row],
            "R": pose[:2, :3].reshape(-1),
            "R_rotation_matrix": pose[:, :3],
            "t": pose[:, 3] - base,
        },
        "camera": {
            "R_base_0": np.eye(3),
            "t_base_0": base,
            "fl": record.intrinsics[row, :1, 0] / size,
            "pp": record.intrinsics[row, :2, 2] / (size / 2 + 0.5) - 1,
        },
    }
    batched = {
        name: {key: np.asarray(value, np.float32)[None] for key, value in table.items()}
        for name, table in arrays.items()
    }
    number = int(record.numbers[row])
    return batched | {"img_size": np.array([size, size]), "frame_id": number, "global_step": 0}
