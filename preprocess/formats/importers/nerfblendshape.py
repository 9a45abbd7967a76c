"""NeRFBlendShape: transforms.json with OpenGL cameras and 46 blendshape coefficients of its own, which are not FLAME's.

Pixel centers have integer coordinates, so half a pixel is added to the principal point. The head model that these
coefficients belong to is not part of the data set: usually the video has to be tracked again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json, write_json
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

TITLE = "NeRFBlendShape: transforms.json with exp_ori (not FLAME)"


def recognizes(folder: Path) -> bool:
    """Whether transforms.json has frames with img_id and exp_ori."""
    path = folder / "transforms.json"
    try:
        frames = read_json(path).get("frames") if path.is_file() else None
    except InputError:
        return False
    first = frames[0] if isinstance(frames, list) and frames else None
    return isinstance(first, dict) and "img_id" in first and "exp_ori" in first


def read(folder: Path) -> TrackingRecord:
    """Read cameras and coefficients; `InputError` naming the file for anything wrong."""
    path = folder / "transforms.json"
    data = read_json(path)
    frames = {}
    for frame in frame_list(path, data):
        number = frame.get("img_id")
        if type(number) is not int or not 0 <= number < 1 << 31:
            raise InputError(f"{path}: expected 'img_id' to be a whole number, found {number!r:.60}")
        frames[number] = frame
    numbers, count = sorted(frames), len(frames)
    width, height = image_size(path, data)
    focal_x, focal_y, center_x, center_y = (finite_number(path, data, key) for key in ("fx", "fy", "cx", "cy"))
    matrices = [
        number_array(path, frames[number].get("transform_matrix"), (4, 4), "'transform_matrix'") for number in numbers
    ]
    expression = [number_array(path, frames[number].get("exp_ori"), (None,), "'exp_ori'") for number in numbers]
    if len({len(values) for values in expression}) != 1:
        raise InputError(f"{path}: expected the same number of coefficients in 'exp_ori' of all frames")
    record = TrackingRecord(
        numbers=np.array(numbers, dtype=np.int64),
        width=width,
        height=height,
        intrinsics=np.tile(camera_matrix(focal_x, focal_y, center_x + 0.5, center_y + 0.5), (count, 1, 1)),
        world_to_camera=np.stack([pose_from_opengl(matrix) for matrix in matrices]),
        expression=np.stack(expression),
        joint_rotations=np.zeros((count, 5, 3)),
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
        version=None,
        notes=("NeRFBlendShape's coefficients are not FLAME's; without their own head model, track the video again",),
    )
    return without_bad_frames(folder, record)


def write(folder: Path, record: TrackingRecord) -> None:
    """Write transforms.json."""
    intrinsics = record.intrinsics[0]
    frames = [
        {
            "img_id": number,
            "transform_matrix": pose_to_opengl(record.world_to_camera[row]).tolist(),
            "exp_ori": record.expression[row].tolist(),
        }
        for row, number in enumerate(record.numbers.tolist())
    ]
    shared = {
        "h": record.height, "w": record.width, "fx": float(intrinsics[0, 0]), "fy": float(intrinsics[1, 1]),
        "cx": float(intrinsics[0, 2]) - 0.5, "cy": float(intrinsics[1, 2]) - 0.5,
    }  # fmt: skip
    write_json(folder / "transforms.json", shared | {"frames": frames})
