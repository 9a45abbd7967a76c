"""SMIRK's output under its encoder's own names, such as pose_params and expression_params.

SMIRK's demo saves no codes, so people save its dictionary: one npz, pickle or torch file for every image, or one for
the whole clip. The camera is DECA's, weak-perspective on a 224 px crop; eyelids are metrical-tracker's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.npz import write_npz
from preprocess.formats.array_files import array_names, read_arrays
from preprocess.formats.array_table import ArrayTable, Assume
from preprocess.formats.frame_set import Frame, FrameSet, read_rows
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.formats.weak_perspective import code_places, read_codes, weak_camera, weak_pose, weak_record

TITLE = "SMIRK codes: an npz, pickle or torch file with pose_params, cam, shape_params, expression_params, jaw_params"
_NEEDED = frozenset({"pose_params", "cam", "shape_params", "expression_params", "jaw_params"})
_KEYS = (*_NEEDED, "eyelid_params")
_MAX_FRAMES = 200_000


def recognizes(path: Path) -> bool:
    """Whether the file, or the first files of the folder, have SMIRK's names."""
    return bool(code_places(path, _NEEDED)) or array_names(path) >= _NEEDED


def read(path: Path) -> TrackingRecord:
    """Read all codes; those of single images that cannot be read are left out.

    Raises:
        InputError: No codes, or most of them cannot be read.
    """
    if path.is_file():
        return weak_record(path, _clip(path))
    places = code_places(path, _NEEDED) or code_places(path, frozenset({"expression_params"}))
    if not places:
        raise InputError(f"{path}: expected {TITLE}; save the dictionary that SMIRK's encoder returns")
    frames, notes = read_codes(path, places, _code)
    return weak_record(path, frames, notes)


def _code(path: Path, assume: Assume) -> Frame:
    """One image's code in our conventions."""
    return _frame(ArrayTable(path, read_arrays(path, _KEYS), assume))


def _frame(table: ArrayTable) -> Frame:
    joints = np.zeros((5, 3))
    joints[0], joints[2] = table.array(("pose_params",), (3,)), table.array(("jaw_params",), (3,))
    lids = table.array(("eyelid_params",), (2,)) if "eyelid_params" in table.values else np.zeros(2)
    return {
        "pose": weak_pose(table.path, table.array(("cam",), (3,))),
        "joints": joints,
        "expression": table.array(("expression_params",), (None,)),
        "shape": table.array(("shape_params",), (None,)),
        "eyelids": lids,
    }


def _clip(path: Path) -> FrameSet:
    """The rows of one file as the frames of a clip, numbered from 0."""
    values = read_arrays(path, _KEYS)
    notes: list[str] = []
    table = ArrayTable(path, values, notes.append, batched=False)
    columns = {name: table.array((name,), (None, size)) for name, size in _columns(table).items()}
    counts = {len(value) for value in columns.values()}
    if len(counts) != 1 or not 1 <= min(counts) <= _MAX_FRAMES:
        raise InputError(f"{path}: expected as many rows in all arrays, found {sorted(counts)}; save the codes again")

    def row_of(row: int, assume: Assume) -> Frame:
        return _frame(ArrayTable(path, {name: value[row] for name, value in columns.items()}, assume, batched=False))

    return read_rows(path, min(counts), row_of)


def _columns(table: ArrayTable) -> dict[str, int | None]:
    sizes: dict[str, int | None] = {"pose_params": 3, "cam": 3, "jaw_params": 3, "eyelid_params": 2}
    sizes |= {"shape_params": None, "expression_params": None}
    return {name: size for name, size in sizes.items() if name in table.values or name != "eyelid_params"}


def write(folder: Path, record: TrackingRecord) -> None:
    """Write one npz per image; `InputError` unless the cameras are weak-perspective as `read` gives them."""
    for row, number in enumerate(record.numbers.tolist()):
        joints = record.joint_rotations[row]
        codes = {"cam": weak_camera(record, row, "SMIRK"), "pose_params": joints[0], "jaw_params": joints[2]}
        codes |= {"expression_params": record.expression[row], "eyelid_params": record.eyelids[row]}
        codes["shape_params"] = record.shape if record.shape is not None else np.zeros(300)
        write_npz(folder / f"{number:05d}.npz", {name: value[None] for name, value in codes.items()})
