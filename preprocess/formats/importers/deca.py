"""DECA and EMOCA codes: per image a folder of npy files or an npz with shape, exp, pose and cam.

Their camera is weak-perspective on a 224 px crop of the face. Give the 224 px crops as INPUT, and prefer a tracker with
a perspective camera for training.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.npz import write_npz
from preprocess.formats.array_files import read_arrays
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_set import Frame
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.formats.weak_perspective import code_places, read_codes, weak_camera, weak_pose, weak_record

TITLE = "DECA / EMOCA codes: NAME.npz or NAME/{shape,exp,pose,cam}.npy"
_NEEDED = frozenset({"exp", "pose", "cam", "shape"})
_KEYS = (*_NEEDED, "eyelid")


def recognizes(folder: Path) -> bool:
    """Whether the first entries have exp, shape, pose and cam."""
    return bool(code_places(folder, _NEEDED))


def read(folder: Path) -> TrackingRecord:
    """Read all codes; those that cannot be read are left out.

    Raises:
        InputError: No codes, or most of them cannot be read.
    """
    places = code_places(folder, _NEEDED) or code_places(folder, frozenset({"exp"}))
    if not places:
        raise InputError(f"{folder}: expected {TITLE}; found no such files; give the folder that contains them")
    frames, notes = read_codes(folder, places, _code)
    return weak_record(folder, frames, notes)


def _code(path: Path, assume: Assume) -> Frame:
    """One image's code in our conventions."""
    table = ArrayTable(path, read_arrays(path, _KEYS), assume, batched=False)
    pose = table.array(("pose",), (6,))
    joints = np.zeros((5, 3))
    joints[0], joints[2] = pose[:3], pose[3:]
    return {
        "pose": weak_pose(path, table.array(("cam",), (3,))),
        "joints": joints,
        "expression": table.array(("exp",), (None,)),
        "shape": table.array(("shape",), (None,)),
        "eyelids": table.array(("eyelid",), (2,)) if "eyelid" in table.values else np.zeros(2),
    }


def write(folder: Path, record: TrackingRecord) -> None:
    """Write one npz per image; `InputError` unless the cameras are weak-perspective as `read` gives them."""
    for row, number in enumerate(record.numbers.tolist()):
        joints = record.joint_rotations[row]
        codes = {"cam": weak_camera(record, row, "DECA"), "pose": np.concatenate((joints[0], joints[2]))}
        codes |= {"exp": record.expression[row], "eyelid": record.eyelids[row]}
        codes["shape"] = record.shape if record.shape is not None else np.zeros(100)
        write_npz(folder / f"{number:05d}.npz", codes)
