"""EMICA codes (inferno): per image a folder of npy files with shape, exp, jawpose, globalpose and cam.

They are DECA's with the pose in two files. The model's folder name tells which FLAME it was trained with: 2020 unless
it says otherwise; a FLAME without jaw is refused. inferno writes the codes only with `--save_codes True`.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from preprocess.formats.array_files import read_arrays
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_set import Frame
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.formats.weak_perspective import code_places, read_codes, weak_camera, weak_pose, weak_record

TITLE = "EMICA codes (inferno): NAME/{shape,exp,jawpose,globalpose,cam}.npy"
_NEEDED = frozenset({"exp", "shape", "jawpose", "globalpose", "cam"})


def recognizes(folder: Path) -> bool:
    """Whether the first entries have exp, shape, jawpose, globalpose and cam."""
    return bool(code_places(folder, _NEEDED))


def read(folder: Path) -> TrackingRecord:
    """Read all codes; those that cannot be read are left out.

    Raises:
        InputError: No codes, most of them cannot be read, or the model's FLAME has no jaw.
    """
    places = code_places(folder, _NEEDED) or code_places(folder, frozenset({"jawpose"}))
    if not places:
        raise InputError(f"{folder}: expected {TITLE}; run inferno's demo with --save_codes True")
    model = folder.resolve().name.lower()
    if "no_jaw" in model or "nojaw" in model:
        raise InputError(
            f"{folder}: expected a model with FLAME's jaw, found one whose name says it has none; run inferno with "
            "EMICA-CVT_flame2020_notexture"
        )
    frames, notes = read_codes(folder, places, _code)
    return weak_record(folder, frames, notes, "flame2023" if "2023" in model else "flame2020")


def _code(path: Path, assume: Assume) -> Frame:
    """One image's code in our conventions."""
    table = ArrayTable(path, read_arrays(path, _NEEDED), assume, batched=False)
    joints = np.zeros((5, 3))
    joints[0], joints[2] = table.array(("globalpose",), (3,)), table.array(("jawpose",), (3,))
    return {
        "pose": weak_pose(path, table.array(("cam",), (3,))),
        "joints": joints,
        "expression": table.array(("exp",), (None,)),
        "shape": table.array(("shape",), (None,)),
        "eyelids": np.zeros(2),
    }


def write(folder: Path, record: TrackingRecord) -> None:
    """Write a folder of npy files per image; `InputError` unless the cameras are as `read` gives them."""
    for row, number in enumerate(record.numbers.tolist()):
        joints = record.joint_rotations[row]
        codes = {"cam": weak_camera(record, row, "EMICA"), "globalpose": joints[0], "jawpose": joints[2]}
        codes |= {"exp": record.expression[row]}
        codes["shape"] = record.shape if record.shape is not None else np.zeros(300)
        for name, value in codes.items():
            write_atomically(folder / f"{number:05d}_00" / f"{name}.npy", partial(_save, value))


def _save(value: np.ndarray, stream: IO[bytes]) -> None:
    np.save(stream, value.astype(np.float32))
