"""SHeaP (Schoneveld): the dictionary that its demo keeps, saved by the user as npz, pickle or torch file.

FLAME 2020 posed by its own root (`torso_pose`) and a translation (`cam_trans`), seen by one fixed camera on 224 px
crops of the head. In a video the crop moves and is not stored: only the cropped images fit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.npz import write_npz
from preprocess.formats.array_files import array_names, read_arrays
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_set import Frame, FrameSet, read_rows
from preprocess.formats.json_fields import camera_matrix
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames
from preprocess.formats.weak_perspective import code_places, read_codes

TITLE = "SHeaP: an npz, pickle or torch file with shape_from_facenet, expr, torso_pose, jaw_pose, cam_trans"
SIDE = 224
FIELD_OF_VIEW = 14.2539
"""Vertical angle of view of SHeaP's fixed camera, degrees."""

_POSE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
_ROTATIONS = ("torso_pose", "neck_pose", "jaw_pose", "eye_l_pose", "eye_r_pose")
_NEEDED = frozenset({"shape_from_facenet", "expr", "cam_trans", "torso_pose", "jaw_pose"})
_KEYS = (*_NEEDED, *_ROTATIONS, "eyelids")


def recognizes(path: Path) -> bool:
    """Whether the file, or the first files of the folder, have SHeaP's names."""
    return bool(code_places(path, _NEEDED)) or array_names(path) >= _NEEDED


def read(path: Path) -> TrackingRecord:
    """Read all frames; those that cannot be used are left out.

    Raises:
        InputError: No such file, or most frames cannot be used.
    """
    frames, notes = _frames(path)
    count = len(frames.numbers)
    focal = SIDE / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    lids = frames.stacked("eyelids")
    record = TrackingRecord(
        numbers=np.array(frames.numbers, dtype=np.int64),
        width=SIDE,
        height=SIDE,
        intrinsics=np.tile(camera_matrix(focal, focal, SIDE / 2, SIDE / 2), (count, 1, 1)),
        world_to_camera=np.tile(_POSE, (count, 1, 1)),
        expression=frames.stacked("expression"),
        joint_rotations=frames.stacked("joints"),
        eyelids=lids,
        translation=frames.stacked("translation"),
        shape=frames.stacked("shape").mean(axis=0),
        camera_is_assumed=True,
        notes=(
            *frames.notes,
            *notes,
            "SHeaP's camera belongs to its own crops of 224 px: give those as INPUT",
            f"SHeaP's camera is always one of {FIELD_OF_VIEW:.1f}°: distance and focal length are assumed",
            "the identity is the clip's mean",
            *(("SHeaP's eyelids are not metrical-tracker's; they are approximate",) if np.any(lids) else ()),
        ),
    )
    return without_bad_frames(path, record)


def _frames(path: Path) -> tuple[FrameSet, tuple[str, ...]]:
    """All frames of a file, or of a folder with one file for each."""
    if path.is_dir():
        places = code_places(path, _NEEDED) or code_places(path, frozenset({"cam_trans"}))
        if not places:
            raise InputError(f"{path}: expected {TITLE}; save the dictionary `predictions` of SHeaP's demo")
        return read_codes(path, places, _single)
    values = read_arrays(path, _KEYS)
    lengths = {len(value) for value in values.values() if isinstance(value, np.ndarray) and value.ndim == 2}
    if len(lengths) != 1 or not 1 <= min(lengths) <= 200_000:
        raise InputError(f"{path}: expected as many rows in all arrays, found {sorted(lengths)}; save it again")

    def row_of(row: int, assume: Assume) -> Frame:
        single = {
            name: value[row : row + 1] if isinstance(value, np.ndarray) else value for name, value in values.items()
        }
        return _frame(ArrayTable(path, single, assume))

    return read_rows(path, min(lengths), row_of), ()


def _single(path: Path, assume: Assume) -> Frame:
    return _frame(ArrayTable(path, read_arrays(path, _KEYS), assume))


def _frame(table: ArrayTable) -> Frame:
    """One frame in our conventions; SHeaP's first eyelid is the subject's right one."""
    present = [name in table.values for name in _ROTATIONS]
    rotations = [
        table.array((name,), (3,)) if here else np.zeros(3) for name, here in zip(_ROTATIONS, present, strict=True)
    ]
    lids = table.array(("eyelids",), (2,)) if "eyelids" in table.values else np.zeros(2)
    return {
        "joints": np.stack(rotations),
        "expression": table.array(("expr",), (None,)),
        "translation": table.array(("cam_trans",), (3,)),
        "eyelids": lids[::-1].copy(),
        "shape": table.array(("shape_from_facenet",), (None,)),
    }


def write(path: Path, record: TrackingRecord) -> None:
    """Write one npz with all frames; `InputError` unless the camera is SHeaP's, which the format does not store."""
    focal = SIDE / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    same = np.allclose(record.intrinsics, camera_matrix(focal, focal, SIDE / 2, SIDE / 2), atol=1e-6)
    if not same or not np.allclose(record.world_to_camera, _POSE, atol=1e-9):
        raise InputError("SHeaP's format holds only its own camera; move the head pose into FLAME first")
    shape = record.shape if record.shape is not None else np.zeros(300)
    arrays = {name: record.joint_rotations[:, row] for row, name in enumerate(_ROTATIONS)}
    arrays |= {"expr": record.expression, "eyelids": record.eyelids[:, ::-1], "cam_trans": record.translation}
    write_npz(path, arrays | {"shape_from_facenet": np.tile(shape, (len(record.numbers), 1))})
