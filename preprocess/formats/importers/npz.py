"""Plain npz for custom trackers: the arrays of our tracking.npz plus `frames`, `width` and `height`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.data.capture_schema import check_tracking, read_tracking
from ggavatar.errors import InputError
from ggavatar.io.npz import npz_headers, read_npz, write_npz
from preprocess.formats.tracking_record import MAX_BAD_SHARE, TrackingRecord, left_out_text, without_bad_frames

TITLE = (
    "plain npz: intrinsics, world_to_camera, expression, joint_rotations, eyelids, translation, frames, width, height"
)


def recognizes(path: Path) -> bool:
    """Whether the path is an npz file that contains `world_to_camera`."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    try:
        return "world_to_camera" in npz_headers(path)
    except InputError:
        return False


def read(path: Path) -> TrackingRecord:
    """Read the file; an optional string `version` names the FLAME version.

    Raises:
        InputError: An array is missing, malformed or of the wrong shape.
    """
    arrays = read_tracking(path)
    count = arrays["intrinsics"].shape[0]
    keep = _finite_rows(arrays, count)
    arrays = {name: value[keep] if len(value) == count and name != "shape" else value for name, value in arrays.items()}
    check_tracking(path, arrays, int(keep.sum()))
    if arrays["joint_rotations"].shape[1] != 5:
        raise InputError(f"{path}: expected rotations of 5 joints (root, neck, jaw, left eye, right eye)")
    extra = read_npz(path, ["frames", "width", "height", "version"])
    width, height = (_size(path, extra, key) for key in ("width", "height"))
    numbers = extra.get("frames", np.arange(count))
    if (
        numbers.shape != (count,)
        or numbers.dtype.kind not in "iu"
        or np.any(np.diff(numbers) <= 0)
        or numbers.min(initial=0) < 0
    ):
        raise InputError(f"{path}: expected 'frames' to be {count} ascending frame numbers of 0 or more")
    names = ("intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "translation")
    values = {name: arrays[name].astype(np.float64) for name in names}
    record = TrackingRecord(
        numbers=numbers.astype(np.int64)[keep],
        width=width,
        height=height,
        intrinsics=values["intrinsics"],
        world_to_camera=values["world_to_camera"],
        expression=values["expression"],
        joint_rotations=values["joint_rotations"],
        eyelids=values["eyelids"],
        translation=values["translation"],
        shape=arrays["shape"].astype(np.float64) if "shape" in arrays else None,
        version=str(extra["version"]) if "version" in extra else None,
        notes=() if keep.all() else (f"{left_out_text(numbers[~keep].tolist(), count)}: not finite",),
    )
    return without_bad_frames(path, record)


def _finite_rows(arrays: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Rows without NaN or infinity in any array; all rows if more than half of them would be lost."""
    keep = np.ones(count, dtype=bool)
    for name, value in arrays.items():
        if name not in ("shape", "landmarks") and len(value) == count and value.dtype.kind == "f":
            keep &= np.isfinite(value).reshape(count, -1).all(axis=1)
    return keep if (~keep).sum() <= MAX_BAD_SHARE * count else np.ones(count, dtype=bool)


def _size(path: Path, arrays: dict[str, np.ndarray], key: str) -> int:
    value = arrays.get(key)
    if value is None or value.shape != () or value.dtype.kind not in "iu" or not 1 <= int(value) <= 16384:
        raise InputError(
            f"{path}: expected {key!r} to be a whole number from 1 to 16384: the size in px of the images that the "
            "intrinsics belong to"
        )
    return int(value)


def write(path: Path, record: TrackingRecord) -> None:
    """Write the file."""
    names = ("intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "translation")
    arrays = {name: getattr(record, name) for name in names}
    arrays |= {"frames": record.numbers, "width": np.array(record.width), "height": np.array(record.height)}
    if record.shape is not None:
        arrays["shape"] = record.shape
    if record.version is not None:
        arrays["version"] = np.array(record.version)
    write_npz(path, arrays)
