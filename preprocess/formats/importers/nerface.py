"""NeRFace: transforms_{train,val,test}.json with 76 Face2Face coefficients, which are not FLAME's.

Cameras have OpenGL axes and are mirrored by a negative focal length in x; to keep poses rigid, the head's left and
right are mirrored instead. Pixel centers have integer coordinates, so half a pixel is added to the principal point.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.images import image_header
from ggavatar.io.json_files import read_json, write_json
from preprocess.formats.json_fields import camera_matrix, frame_list, invert_pose, listed_numbers, number_array
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames

TITLE = "NeRFace: transforms_{train,val,test}.json with expression and bbox (not FLAME)"
_PARTS = ("train", "val", "test")
DEFAULT_SIZE = 512
"""Image side without images beside the files, px."""


def _files(folder: Path) -> list[Path]:
    return [path for part in _PARTS if (path := folder / f"transforms_{part}.json").is_file()]


FOREIGN_COEFFICIENTS = "NeRFace's coefficients are not FLAME's; without their own head model, track the video again"


def recognizes(folder: Path) -> bool:
    """Whether a split file has `intrinsics` and frames with `expression`."""
    try:
        data = read_json(_files(folder)[0]) if _files(folder) else {}
    except InputError:
        return False
    frames = data.get("frames")
    first = frames[0] if isinstance(frames, list) and frames else None
    return "intrinsics" in data and isinstance(first, dict) and "expression" in first


def read(folder: Path) -> TrackingRecord:
    """Read cameras and coefficients of all splits; `InputError` naming the file for anything wrong."""
    files = _files(folder)
    if not files:
        raise InputError(f"{folder}: expected transforms_train.json, transforms_val.json or transforms_test.json")
    width, height = _image_size(folder)
    by_name: dict[object, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}  # splits may share frames
    for path in files:
        data = read_json(path)
        lens = number_array(path, data.get("intrinsics"), (4,), "'intrinsics'")
        if 0 in lens[:2]:
            raise InputError(f"{path}: expected focal lengths other than zero in 'intrinsics'")
        for frame in frame_list(path, data):
            name = frame.get("file_path")
            name = PurePosixPath(name).name if isinstance(name, str) else repr(name)
            by_name[name] = _frame(path, frame, lens, width, height)
    listed = listed_numbers(folder, list(by_name))
    found = listed.by_number(list(by_name.values()))
    numbers, count = sorted(found), len(found)
    if len({len(found[number][2]) for number in numbers}) != 1:
        raise InputError(f"{files[0]}: expected the same number of coefficients in 'expression' of all frames")
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=width,
        height=height,
        intrinsics=np.stack([found[number][0] for number in numbers]),
        world_to_camera=np.stack([found[number][1] for number in numbers]),
        expression=np.stack([found[number][2] for number in numbers]),
        joint_rotations=np.zeros((count, 5, 3)),
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
        version=None,
        notes=(*listed.notes, FOREIGN_COEFFICIENTS),
    )
    return without_bad_frames(folder, record)


def _image_size(folder: Path) -> tuple[int, int]:
    for part in _PARTS:
        found = sorted((folder / part).glob("*.png")) if (folder / part).is_dir() else []
        if found:
            header = image_header(found[0])
            return header.width, header.height
    return DEFAULT_SIZE, DEFAULT_SIZE


def _frame(
    path: Path, frame: Mapping[str, Any], lens: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intrinsics, world-to-camera and coefficients of one frame."""
    matrix = number_array(path, frame.get("transform_matrix"), (4, 4), "'transform_matrix'")
    mirrored = np.sign(lens[0])
    pose = np.diag([mirrored, -1.0, -1.0, 1.0]) @ invert_pose(matrix) @ np.diag([mirrored, 1.0, 1.0, 1.0])
    intrinsics = camera_matrix(abs(lens[0]), abs(lens[1]), lens[2] * width + 0.5, lens[3] * height + 0.5)
    return intrinsics, pose, number_array(path, frame.get("expression"), (None,), "'expression'")


def write(folder: Path, record: TrackingRecord) -> None:
    """Write the three files: the last 20 % of the frames test, the last training frame is the only validation frame."""
    first = record.intrinsics[0]
    lens = [-first[0, 0], first[1, 1], (first[0, 2] - 0.5) / record.width, (first[1, 2] - 0.5) / record.height]
    frames = []
    for row, number in enumerate(record.numbers.tolist()):
        pose = np.diag([-1.0, -1.0, -1.0, 1.0]) @ record.world_to_camera[row] @ np.diag([-1.0, 1.0, 1.0, 1.0])
        frames.append(
            {
                "file_path": f"./train/f_{number:04d}",
                "bbox": [0.0, 1.0, 0.0, 1.0],
                "transform_matrix": invert_pose(pose).tolist(),
                "expression": record.expression[row].tolist(),
            }
        )
    train = max(1, round(0.8 * len(frames)))
    angle = 2 * float(np.arctan(record.width / (2 * first[0, 0])))
    for part, chosen in {"train": frames[:train], "val": frames[train - 1 : train], "test": frames[train:]}.items():
        if chosen:
            shared = {"camera_angle_x": angle, "intrinsics": [float(value) for value in lens]}
            write_json(folder / f"transforms_{part}.json", shared | {"frames": chosen})
