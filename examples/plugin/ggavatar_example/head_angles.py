"""Head angles: a CSV with a line per frame, from a head tracker that knows no FLAME.

    frame,width,height,focal,x,y,z,yaw,pitch,roll,jaw
    0,512,512,1100,0.0,0.0,0.8,3.5,-1.2,0.0,0.1

Position of the head in the camera's space (x right, y down, z away) in m; angles in degrees; the jaw's opening in rad.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ggavatar.errors import InputError
from ggavatar.io.regular_files import read_file, read_start
from preprocess.formats.tracking_record import TrackingRecord

TITLE = "head angles: a CSV with the columns frame, width, height, focal, x, y, z, yaw, pitch, roll, jaw"
COLUMNS = ("frame", "width", "height", "focal", "x", "y", "z", "yaw", "pitch", "roll", "jaw")
MAX_BYTES = 1 << 26


def recognizes(path: Path) -> bool:
    """Whether the path is a CSV that begins with our columns; never raises for another file."""
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    return read_start(path, 200).decode("utf-8", "replace").split("\n")[0].strip() == ",".join(COLUMNS)


def read(path: Path) -> TrackingRecord:
    """The tracking in GGAvatar's conventions (docs/conventions.md); `InputError` for anything wrong."""
    table = _table(path)
    numbers, (width, height) = table["frame"].astype(np.int64), (int(table[key][0]) for key in ("width", "height"))
    if (np.diff(numbers) <= 0).any() or numbers[0] < 0:
        raise InputError(f"{path}: expected ascending frame numbers of 0 or more, found others; sort the lines")
    count = len(numbers)
    intrinsics = np.tile(np.eye(3), (count, 1, 1))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = table["focal"]
    intrinsics[:, 0, 2], intrinsics[:, 1, 2] = width / 2, height / 2
    # The head looks along its own +z with y up, the camera along +z with y down: half a turn about x at rest.
    turns = Rotation.from_euler("YXZ", np.stack([table[key] for key in ("yaw", "pitch", "roll")], 1), degrees=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = np.diag([1.0, -1.0, -1.0]) @ turns.as_matrix()
    poses[:, :3, 3] = np.stack([table[key] for key in ("x", "y", "z")], 1)
    joints = np.zeros((count, 5, 3))
    joints[:, 2, 0] = table["jaw"]
    return TrackingRecord(
        numbers=numbers,
        width=width,
        height=height,
        intrinsics=intrinsics,
        world_to_camera=poses,
        expression=np.zeros((count, 1)),
        joint_rotations=joints,
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
        version=None,
        notes=("head angles have no expression but the jaw's",),
    )


def _table(path: Path) -> dict[str, np.ndarray]:
    """The columns as numbers; `InputError` that names the line."""
    text = read_file(path, MAX_BYTES, "a CSV of head angles").decode("utf-8", "replace")
    rows = list(csv.DictReader(io.StringIO(text)))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise InputError(f"{path}: expected the columns {', '.join(COLUMNS)} and a line per frame, found others")
    try:
        return {name: np.array([float(row[name] or "nan") for row in rows]) for name in COLUMNS}
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: expected a number in every cell ({error}); export the tracking again") from error
