"""NeRSemble benchmark: flame2023_tracking_v2.npz of a sequence, with the cameras of the person's calibration.

FLAME 2023 with jaw. The head is posed outside of FLAME, X = scale·R·v + translation about the origin, which is folded
into the camera with FLAME left unscaled. The file's `rotation` is Euler angles (intrinsic XYZ), not axis-angle;
`rotation_matrices` is used. Images are the benchmark's videos, `images/cam_SERIAL.mp4`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json, write_json
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.array_files import array_names
from preprocess.formats.array_table import ArrayTable
from preprocess.formats.json_fields import number_array
from preprocess.formats.tracking_record import MAX_MAGNITUDE, TrackingRecord, without_bad_frames

TITLE = "NeRSemble benchmark: flame2023_tracking_v2.npz with calibration/camera_params.json in a folder above it"
TRAINING_CAMERA = "222200037"
"""The camera that the monocular benchmark trains on."""

SIZES = ((512, 512), (1100, 1604), (2200, 3208))
"""Width and height of the monocular benchmark's videos, of the novel-view benchmark's, and of the data set's, px."""

_NEEDED = frozenset({"expression", "rotation_matrices", "translation", "scale", "jaw", "neck", "eyes", "shape"})
_KEYS = (*_NEEDED, "rotation", "frames")
_CALIBRATION = Path("calibration") / "camera_params.json"
_LEVELS = 5


def recognizes(path: Path) -> bool:
    """Whether the npz, or the one in the folder or its `tracking`, has the benchmark's arrays."""
    return _file(path) is not None


def _file(path: Path) -> Path | None:
    return next((file for file in _candidates(path) if array_names(file) >= _NEEDED), None)


def _candidates(path: Path) -> list[Path]:
    """The file itself, or the npz files in a sequence's folder; the newest version of the tracking comes first."""
    if not path.is_dir():
        return [path]
    return [file for place in (path, path / "tracking") for file in sorted(place.glob("*.npz"), reverse=True)][:100]


def read(path: Path) -> TrackingRecord:
    """Read a sequence with the training camera, or the first one if there is none.

    Raises:
        InputError: Not such a file, no calibration in a folder above it, or rotations that contradict each other.
    """
    file = _file(path) or next(iter(_candidates(path)), path)
    notes: list[str] = []
    table = ArrayTable(file, read_npz(file, _KEYS), notes.append, batched=False)
    count = len(table.array(("expression",), (None, None)))
    intrinsics, pose, camera_note = _camera(file)
    width, height = _size(intrinsics)
    joints = np.zeros((count, 5, 3))
    joints[:, 1], joints[:, 2] = table.array(("neck",), (count, 3)), table.array(("jaw",), (count, 3))
    joints[:, 3:] = table.array(("eyes",), (count, 6)).reshape(count, 2, 3)
    record = TrackingRecord(
        numbers=np.arange(count),
        width=width,
        height=height,
        intrinsics=np.tile(intrinsics, (count, 1, 1)),
        world_to_camera=_folded(table, pose, count),
        expression=table.array(("expression",), (count, None)),
        joint_rotations=joints,
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
        shape=table.array(("shape",), (None,)),
        version="flame2023",
        notes=(
            *notes,
            camera_note,
            f"images of {width}×{height} px are assumed, judging by the principal point",
            *_frame_note(table, count),
            *_version_note(file),
        ),
    )
    return without_bad_frames(file, record)


def _frame_note(table: ArrayTable, count: int) -> tuple[str, ...]:
    frames = table.values.get("frames")
    counted = frames is None or (frames.shape == (count,) and np.array_equal(frames, np.arange(count)))
    return (
        () if counted else ("the file's own frame numbers are not 0, 1, 2, …: row k is taken as frame k of the video",)
    )


def _version_note(file: Path) -> tuple[str, ...]:
    superseded = file.name == "flame2023_tracking.npz"
    return ("flame2023_tracking.npz is superseded by flame2023_tracking_v2.npz",) if superseded else ()


def _folded(table: ArrayTable, pose: np.ndarray, count: int) -> np.ndarray:
    """World-to-camera of every frame with scale, rotation and translation of the head folded in."""
    turns = table.array(("rotation_matrices",), (count, 3, 3))
    scale = float(table.array(("scale",), (1,))[0])
    if not 1e-3 < scale < 1e3:
        raise InputError(f"{table.path}: expected a positive 'scale', found {scale:g}; download the file again")
    _check_rotations(table, turns)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = pose[:3, :3] @ turns
    poses[:, :3, 3] = (table.array(("translation",), (count, 3)) @ pose[:3, :3].T + pose[:3, 3]) / scale
    return poses


def _check_rotations(table: ArrayTable, turns: np.ndarray) -> None:
    """Refuse matrices that are no rotations, or not those of the Euler angles beside them."""
    good = np.isfinite(turns).all(axis=(1, 2))
    products = np.einsum("tij,tkj->tik", turns[good], turns[good])
    if good.any() and np.abs(products - np.eye(3)).max() > 1e-3:
        raise InputError(f"{table.path}: expected rotations in 'rotation_matrices', found others; download it again")
    if "rotation" in table.values:
        angles = table.array(("rotation",), (len(turns), 3))
        good &= np.isfinite(angles).all(axis=1)
        if good.any() and np.abs(Rotation.from_euler("XYZ", angles[good]).as_matrix() - turns[good]).max() > 1e-3:
            raise InputError(
                f"{table.path}: expected 'rotation' to be the Euler angles (XYZ) of 'rotation_matrices'; download the "
                "file again"
            )


def _camera(file: Path) -> tuple[np.ndarray, np.ndarray, str]:
    """Intrinsics and world-to-camera of the chosen camera, and a note on the choice."""
    path = _calibration(file)
    data = read_json(path)
    poses, intrinsics = data.get("world_2_cam"), data.get("intrinsics")
    if not isinstance(poses, Mapping) or not poses or len(poses) > 10_000:
        raise InputError(f"{path}: expected cameras by serial number under 'world_2_cam'; download the file again")
    serial = TRAINING_CAMERA if TRAINING_CAMERA in poses else min(poses)
    pose = number_array(path, poses[serial], (4, 4), f"'world_2_cam' of {serial}")
    if np.abs(pose).max() > MAX_MAGNITUDE or np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-3:
        raise InputError(f"{path}: expected a rigid pose of camera {serial} in 'world_2_cam'; download the file again")
    shared: Any = intrinsics.get(serial) if isinstance(intrinsics, Mapping) else intrinsics
    matrix = number_array(path, shared, (3, 3), f"'intrinsics' of {serial}")
    if np.abs(matrix).max() > MAX_MAGNITUDE:
        raise InputError(f"{path}: expected 'intrinsics' of camera {serial} in px, found others; download it again")
    return matrix, pose, f"camera {serial} of {len(poses)} is used: INPUT is images/cam_{serial}.mp4"


def _calibration(file: Path) -> Path:
    """The calibration in one of the folders above the tracking, or beside it."""
    parents = file.resolve().parents[:_LEVELS]
    candidates = [file.resolve().with_name(_CALIBRATION.name), *(parent / _CALIBRATION for parent in parents)]
    found = next((path for path in candidates if path.is_file()), None)
    if found is None:
        raise InputError(
            f"{file}: expected {_CALIBRATION} in a folder above it, as the benchmark lays it out, found none; put "
            f"{_CALIBRATION.name} beside the npz"
        )
    return found


def _size(intrinsics: np.ndarray) -> tuple[int, int]:
    """The size whose center is closest to the principal point."""
    center = intrinsics[:2, 2]
    return min(SIZES, key=lambda size: float(np.abs(center - np.array(size) / 2).max()))


def write(folder: Path, record: TrackingRecord) -> None:
    """Write `tracking/flame2023_tracking_v2.npz` and `calibration/camera_params.json`: a person with one sequence.

    Raises:
        InputError: The head is posed by FLAME's root or translation, the focal length changes, or the images have
            another size than the benchmark's.
    """
    if np.abs(record.joint_rotations[:, 0]).max() > 1e-6 or np.abs(record.translation).max() > 1e-9:
        raise InputError("NeRSemble's format has no root rotation of FLAME's own; move it into the camera first")
    if np.ptp(record.intrinsics, axis=0).max() > 1e-6 or (record.width, record.height) not in SIZES:
        raise InputError(
            "NeRSemble's format holds one camera on images of 512×512 px; prepare the clip with --size 512"
        )
    pose = record.world_to_camera[0]
    turns = pose[:3, :3].T @ record.world_to_camera[:, :3, :3]
    joints, count = record.joint_rotations, len(record.numbers)
    shape = record.shape if record.shape is not None else np.zeros(300)
    arrays = {
        "shape": np.pad(shape, (0, max(0, 300 - len(shape))))[None],
        "expression": np.pad(record.expression, ((0, 0), (0, max(0, 100 - record.expression.shape[1])))),
        "rotation": Rotation.from_matrix(turns).as_euler("XYZ"),
        "rotation_matrices": turns,
        "translation": (record.world_to_camera[:, :3, 3] - pose[:3, 3]) @ pose[:3, :3],
        "jaw": joints[:, 2],
        "neck": joints[:, 1],
        "eyes": joints[:, 3:].reshape(count, 6),
        "scale": np.ones((1, 1)),
        "frames": np.arange(count),
    }
    write_npz(folder / "tracking" / "flame2023_tracking_v2.npz", arrays)
    cameras = {"world_2_cam": {TRAINING_CAMERA: pose.tolist()}}
    write_json(folder / _CALIBRATION, cameras | {"intrinsics": {TRAINING_CAMERA: record.intrinsics[0].tolist()}})
