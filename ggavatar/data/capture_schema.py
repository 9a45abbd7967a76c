"""Validation of a capture folder, file by file (docs/capture-format.md).

Every error names the file and a next step.

The fields of capture.json are checked by hand: most rules span several fields (ascending frames, disjoint splits of
these frames), pydantic or msgspec would be a new dependency, and would add 28 to 42 ms to the 140 ms in which
`ggavatar.data.capture` starts without torch (measured 2026-11-30).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.io.images import image_header
from ggavatar.io.json_files import read_json, readable_json
from ggavatar.io.npz import npz_headers, read_npz

SCHEMA, VERSION = "ggavatar-capture", 1
REMAKE = "create the capture again with ggavatar-prep"
RECORDS = ".prep"
"""Subfolder with the records of ggavatar-prep's stages; it marks a capture as created by ggavatar-prep."""

_TRACKING_SHAPES: dict[str, tuple[int | str, ...]] = {
    "intrinsics": ("T", 3, 3),
    "world_to_camera": ("T", 4, 4),
    "expression": ("T", "E"),
    "joint_rotations": ("T", "J", 3),
    "eyelids": ("T", 2),
    "translation": ("T", 3),
    "shape": ("S",),
    "landmarks": ("T", "L", 2),
    "torso_to_camera": ("T", 4, 4),
}
_TRACKING_OPTIONAL = frozenset({"shape", "landmarks", "torso_to_camera"})
_HEAD_SHAPES: dict[str, tuple[int | str, ...]] = {
    "template": ("V", 3),
    "faces": ("F", 3),
    "expression_basis": ("V", 3, "E"),
    "pose_basis": ("V", 3, "P"),
    "eyelid_basis": ("V", 3, 2),
    "joint_regressor": ("J", "V"),
    "skinning_weights": ("V", "J"),
    "parents": ("J",),
    "joint_names": ("J",),
    "version": (),
}


@contextmanager
def with_remedy(folder: Path) -> Iterator[None]:
    """Append how to repair the capture to any `InputError` about a capture that ggavatar-prep created."""
    try:
        yield
    except InputError as error:
        if REMAKE in str(error) or not (folder / RECORDS).is_dir() or not (folder / "capture.json").exists():
            raise
        raise InputError(
            f"{error}; run the same ggavatar-prep command with --overwrite to create the capture again"
        ) from error


def read_description(path: Path) -> dict[str, Any]:
    """Read capture.json and check every field.

    Raises:
        InputError: The file is missing, not JSON, of an unknown version, or a required field is missing or invalid.
    """
    if not path.exists():
        if (path.parent / RECORDS).is_dir():
            raise InputError(
                f"{path}: missing, so the capture is not finished; run the same ggavatar-prep command with --resume"
            )
        raise InputError(
            f"{path}: no such file, so {path.parent} is not a capture; create one with ggavatar-prep VIDEO -o FOLDER"
        )
    data = read_json(path)
    _expect(path, data.get("schema") == SCHEMA, f'"schema" to be {SCHEMA!r}', data.get("schema"))
    if data.get("version") != VERSION:
        raise InputError(
            f"{path}: schema version {data.get('version')!r} is unknown, this version of GGAvatar reads {VERSION}; "
            f"update GGAvatar, or {REMAKE}"
        )
    subject, fps, head = data.get("subject"), data.get("fps"), data.get("head")
    _expect(path, isinstance(subject, str) and subject != "", '"subject" to be a name', subject)
    for key in ("width", "height"):
        _expect(
            path,
            type(data.get(key)) is int and 0 < data[key] <= 16384,
            f'"{key}" to be a whole number of px up to 16384',
            data.get(key),
        )
    valid = isinstance(fps, int | float) and not isinstance(fps, bool) and 0 < fps < math.inf
    _expect(path, valid, '"fps" to be a positive number', fps)
    _expect(
        path, isinstance(head, dict) and isinstance(head.get("version"), str), '"head" to be {"version": tag}', head
    )
    _check_frames(path, data.get("frames"))
    _check_splits(path, data.get("splits"), data["frames"])
    _expect(path, isinstance(data.get("source", {}), dict), '"source" to be an object', data.get("source"))
    dropped = data.get("dropped", [])
    _expect(
        path,
        isinstance(dropped, list) and all(isinstance(item, dict) for item in dropped),
        '"dropped" to be a list of objects',
        dropped,
    )
    return data


def _expect(path: Path, holds: bool, expected: str, found: object) -> None:
    if not holds:
        shown = repr(found)
        raise InputError(
            f"{path}: expected {expected}, found {shown if len(shown) < 80 else shown[:80] + '…'}; {REMAKE}"
        )


def _check_frames(path: Path, frames: object) -> None:
    """Frame numbers: at least one, whole numbers from 0, strictly ascending."""
    _expect(path, isinstance(frames, list) and len(frames) > 0, '"frames" to list the frame numbers', frames)
    assert isinstance(frames, list)
    whole = all(type(number) is int and 0 <= number < 1 << 31 for number in frames)
    _expect(
        path,
        whole and all(a < b for a, b in itertools.pairwise(frames)),
        '"frames" to be ascending whole numbers',
        frames,
    )


def _check_splits(path: Path, splits: object, frames: list[int]) -> None:
    """Splits: each holds two disjoint lists of frames of this capture."""
    _expect(path, isinstance(splits, dict) and "every-20th" in splits, '"splits" to hold at least "every-20th"', splits)
    assert isinstance(splits, dict)
    known = set(frames)
    for name, lists in splits.items():
        shaped = isinstance(lists, dict) and all(isinstance(lists.get(part), list) for part in ("train", "test"))
        _expect(path, shaped, f'split {name!r} to be {{"train": [...], "test": [...]}}', lists)
        for part in ("train", "test"):
            _expect(
                path,
                all(type(number) is int for number in lists[part]),
                f"{part} frames of split {name!r} to be whole numbers",
                lists[part],
            )
            unknown = sorted(set(lists[part]) - known)
            _expect(path, not unknown, f"{part} frames of split {name!r} to be frames of the capture", unknown)
        both = sorted(set(lists["train"]) & set(lists["test"]))
        _expect(path, not both, f"split {name!r} to share no frame between training and test", both)


def write_description(path: Path, fields: Mapping[str, Any]) -> None:
    """Write capture.json atomically, schema and version first.

    Unlike `write_json` it keeps non-ASCII text, and the bytes of existing captures, on which their digests depend.
    """
    text = readable_json({"schema": SCHEMA, "version": VERSION, **fields}, indent=1)
    write_text(path, text)


def read_tracking(path: Path) -> dict[str, np.ndarray]:
    """The arrays of tracking.npz; `InputError` if one is missing or has a wrong shape or type."""
    headers = npz_headers(path)
    sizes: dict[str, int] = {}
    for name, shape in _TRACKING_SHAPES.items():
        if name in headers:
            _match(path, name, headers[name].shape, shape, sizes)
            if headers[name].dtype.kind != "f":
                raise InputError(f"{path}: expected {name!r} in floating point, found {headers[name].dtype}; {REMAKE}")
        elif name not in _TRACKING_OPTIONAL:
            raise InputError(f"{path}: no array {name!r}; {REMAKE}")
    return read_npz(path, _TRACKING_SHAPES.keys())


def _match(path: Path, name: str, found: tuple[int, ...], wanted: tuple[int | str, ...], sizes: dict[str, int]) -> None:
    """Compare a shape with a pattern, in which each letter stands for the size it first occurs with."""
    fits = len(found) == len(wanted)
    for size, want in zip(found, wanted, strict=False):
        fits = fits and size == (sizes.setdefault(want, size) if isinstance(want, str) else want)
    if not fits:
        meant = ", ".join(
            f"{want}={sizes[want]}" if isinstance(want, str) and want in sizes else str(want) for want in wanted
        )
        raise InputError(f"{path}: expected {name!r} of shape ({meant}), found {found}; {REMAKE}")


def check_tracking(path: Path, arrays: Mapping[str, np.ndarray], count: int) -> None:
    """Check one row per frame, finite numbers (except landmarks), valid intrinsics and rigid poses."""
    rows = arrays["intrinsics"].shape[0]
    if rows != count:
        raise InputError(f"{path}: expected {count} rows, one for each frame in capture.json, found {rows}; {REMAKE}")
    for name, array in arrays.items():
        bad = ~np.isfinite(array)
        if name != "landmarks" and bad.any():
            where = f"row {np.argwhere(bad)[0][0]}" if name != "shape" else "it"
            raise InputError(
                f"{path}: {name!r} holds NaN or infinity, first in {where}; drop that frame or track the video again"
            )
    _check_intrinsics(path, arrays["intrinsics"])
    for name in {"world_to_camera", "torso_to_camera"} & set(arrays):
        _check_rigid(path, name, arrays[name])


def _check_intrinsics(path: Path, intrinsics: np.ndarray) -> None:
    fixed = intrinsics[:, [0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
    wrong = (np.abs(fixed - np.array([0, 0, 0, 0, 1])) > 1e-4).any(axis=1) | (intrinsics[:, [0, 1], [0, 1]] <= 0).any(
        axis=1
    )
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        found = np.array2string(intrinsics[row], precision=4).replace("\n", "")
        raise InputError(
            f"{path}: 'intrinsics' row {row}: expected [[fx 0 cx] [0 fy cy] [0 0 1]] with positive focal lengths, "
            f"found {found}"
        )


def _check_rigid(path: Path, name: str, poses: np.ndarray) -> None:
    rotation = poses[:, :3, :3].astype(np.float64)
    skewed = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > 1e-3
    mirrored = np.linalg.det(rotation) < 0
    last = np.abs(poses[:, 3] - np.array([0, 0, 0, 1])).max(axis=1) > 1e-6
    for wrong, what in (
        (skewed, "scales or shears"),
        (mirrored, "is mirrored"),
        (last, "has a last row other than 0 0 0 1"),
    ):
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise InputError(
                f"{path}: {name!r} row {row} is not a rigid transform: it {what}; import the tracking "
                "again with ggavatar-prep"
            )


def check_head(path: Path, version: str, expressions: int, joints: int) -> None:
    """Check arrays and shapes of head.npz and that its parameter space is the tracking's; large arrays are not read."""
    headers = npz_headers(path)
    sizes: dict[str, int] = {}
    for name, shape in _HEAD_SHAPES.items():
        if name not in headers:
            raise InputError(f"{path}: no array {name!r}; {REMAKE}")
        _match(path, name, headers[name].shape, shape, sizes)
    found = str(read_npz(path, ["version"])["version"])
    if found != version:
        raise InputError(
            f"{path}: the head's version is {found!r}, capture.json says {version!r}; coefficients of different "
            f"heads are not interchangeable; {REMAKE}"
        )
    for letter, count, what in (("E", expressions, "expression coefficients"), ("J", joints, "joints")):
        if sizes[letter] != count:
            raise InputError(f"{path}: the head has {sizes[letter]} {what}, tracking.npz has {count}; {REMAKE}")


def check_images(paths: Iterable[Path], width: int, height: int) -> None:
    """Check that every image exists and has the stated size; only headers are read."""
    for path in paths:
        header = image_header(path)
        if (header.width, header.height) != (width, height):
            raise InputError(
                f"{path}: expected {width}×{height} px as capture.json says, found "
                f"{header.width}×{header.height}; {REMAKE}"
            )
