"""flame-head-tracker (Yan) v4: one npz per image with `cam`, `fov`, `K` and FLAME 2020, the head pose in the camera.

`cam` is (yaw, pitch, roll, x, y, z) of the camera in OpenGL's axes. By default the tracker crops, turns and scales
every frame on its own and does not store how, so its cameras belong to the `img` in each npz, not to the video: the
same folder is given as INPUT.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ggavatar.errors import InputError
from ggavatar.io.npz import write_npz
from preprocess.formats.array_files import read_arrays
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_set import Frame
from preprocess.formats.json_fields import camera_matrix, invert_pose
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames
from preprocess.formats.weak_perspective import code_places, read_codes

TITLE = "flame-head-tracker: folder of %d.npz with cam, fov, K, exp and head_pose"
SIDE = 256
"""The camera matrices are those of images of this size, px; the images themselves have 512 px."""

_NEEDED = frozenset({"cam", "K", "fov", "exp", "shape", "jaw_pose", "eye_pose"})
_KEYS = (*_NEEDED, "head_pose", "neck_pose")
_OPENGL = np.diag([1.0, -1.0, -1.0])


def recognizes(folder: Path) -> bool:
    """Whether the first npz files have cam, fov, K and FLAME's parameters."""
    return bool(code_places(folder, _NEEDED))


def read(folder: Path) -> TrackingRecord:
    """Read every npz; those that cannot be read are left out, frames without a face have none.

    Raises:
        InputError: No such files, or most of them cannot be used.
    """
    places = code_places(folder, _NEEDED) or code_places(folder, frozenset({"cam"}))
    if not places:
        raise InputError(f"{folder}: expected {TITLE}; give the folder that flame-head-tracker saved")
    frames, notes = read_codes(folder, places, _read_frame)
    shapes = frames.stacked("shape")
    record = TrackingRecord(
        numbers=np.array(frames.numbers, dtype=np.int64),
        width=SIDE,
        height=SIDE,
        intrinsics=frames.stacked("intrinsics"),
        world_to_camera=frames.stacked("pose"),
        expression=frames.stacked("expression"),
        joint_rotations=frames.stacked("joints"),
        eyelids=np.zeros((len(frames.numbers), 2)),
        translation=np.zeros((len(frames.numbers), 3)),
        shape=shapes.mean(axis=0),
        notes=(
            *frames.notes,
            *notes,
            "the cameras belong to the images in the npz files: give the same folder as INPUT, not the video",
            *(() if np.allclose(shapes, shapes[0], atol=1e-5) else ("the identity is the clip's mean",)),
        ),
    )
    return without_bad_frames(folder, record)


def _read_frame(path: Path, assume: Assume) -> Frame:
    """The content of one file in our conventions."""
    table = ArrayTable(path, read_arrays(path, _KEYS), assume)
    yaw, pitch, roll, *position = table.array(("cam",), (6,)).tolist()
    camera_to_world = np.eye(4)
    camera_to_world[:3, :3] = Rotation.from_euler("ZYX", [roll, yaw, pitch]).as_matrix() @ _OPENGL
    camera_to_world[:3, 3] = position
    intrinsics = table.array(("K",), (3, 3))
    if not SIDE / 4 < intrinsics[0, 2] < SIDE * 3 / 4:
        raise InputError(
            f"{path}: expected 'K' of an image of {SIDE} px, found a principal point at {intrinsics[0, 2]:.0f} px; "
            "track the video with version 4 or newer"
        )
    joints = np.zeros((5, 3))
    for row, name in enumerate(("head_pose", "neck_pose", "jaw_pose")):
        if name in table.values:
            joints[row] = table.array((name,), (3,))
    joints[3:] = table.array(("eye_pose",), (6,)).reshape(2, 3)
    return {
        "intrinsics": intrinsics,
        "pose": invert_pose(camera_to_world),
        "expression": table.array(("exp",), (None,)),
        "joints": joints,
        "shape": table.array(("shape",), (None,)),
    }


def write(folder: Path, record: TrackingRecord) -> None:
    """Write one npz per image, without the images.

    Raises:
        InputError: The images are not square, or the head is posed by FLAME's translation.
    """
    if record.width != record.height or np.abs(record.translation).max() > 1e-9:
        raise InputError(
            "flame-head-tracker's format holds only square images and no translation; move it into the camera first"
        )
    for row, number in enumerate(record.numbers.tolist()):
        write_npz(folder / f"{number}.npz", {name: value[None] for name, value in _arrays(record, row).items()})


def _arrays(record: TrackingRecord, row: int) -> dict[str, np.ndarray]:
    camera_to_world = invert_pose(record.world_to_camera[row])
    roll, yaw, pitch = Rotation.from_matrix(camera_to_world[:3, :3] @ _OPENGL).as_euler("ZYX")
    scale = SIDE / record.width
    focal, center = record.intrinsics[row][[0, 1], [0, 1]] * scale, record.intrinsics[row][:2, 2] * scale
    joints = record.joint_rotations[row]
    shape = record.shape if record.shape is not None else np.zeros(300)
    return {
        "shape": np.pad(shape, (0, max(0, 300 - len(shape)))),
        "exp": np.pad(record.expression[row], (0, max(0, 100 - record.expression.shape[1]))),
        "head_pose": joints[0],
        "neck_pose": joints[1],
        "jaw_pose": joints[2],
        "eye_pose": joints[3:].reshape(-1),
        "cam": np.array([yaw, pitch, roll, *camera_to_world[:3, 3]]),
        "fov": np.array(np.degrees(2 * np.arctan(SIDE / 2 / focal[0]))),
        "K": camera_matrix(focal[0], focal[1], center[0], center[1]),
    }
