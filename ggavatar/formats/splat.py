"""`.splat` (antimatter15): 32 bytes per Gaussian, no header, no view-dependent color."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.formats.axes import Axes, in_our_axes
from ggavatar.formats.ply import MAX_ROWS
from ggavatar.formats.sound_rows import sound_rows
from ggavatar.formats.stored_gaussians import MIN_SCALE, StoredGaussians, rotate_180_about_x
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.io.atomic import write_atomically

QUATERNION_TOLERANCE = 0.05
"""Largest deviation from length 1 of a quaternion of four bytes, by which a file without a header is recognized."""
RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])


def write_splat(path: Path, rows: StoredGaussians) -> None:
    """Write Gaussians given in our axes, rotated to the axes of viewers.

    Position and linear scale are float32 (m), color and opacity are bytes, the unit quaternion wxyz is bytes
    q·128 + 128. Gaussians are sorted by volume times opacity, largest first: viewers show the beginning of a file
    while the rest loads.
    """
    rows = rotate_180_about_x(rows)
    opacities = 1 / (1 + np.exp(-rows.opacity_logits.astype(np.float64)))
    importance = np.exp(rows.log_scales.sum(axis=1, dtype=np.float64)) * opacities
    order = np.argsort(-importance, kind="stable")
    records = np.zeros(len(rows), RECORD)
    records["mean"] = rows.means[order]
    records["scale"] = np.exp(rows.log_scales[order])
    records["color"][:, :3] = _byte((0.5 + SH_C0 * rows.sh_dc[order]) * 255)
    records["color"][:, 3] = _byte(opacities[order] * 255)
    unit = rows.quats / np.linalg.norm(rows.quats, axis=1, keepdims=True)
    records["quat"] = _byte(unit[order] * 128 + 128)
    write_atomically(path, lambda stream: stream.write(records.tobytes()))


def _byte(values: np.ndarray) -> np.ndarray:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def looks_like_splat(path: Path) -> bool:
    """Whether the first records of a file are Gaussians: the format has no header to tell it by."""
    size = path.stat().st_size
    if size == 0 or size % RECORD.itemsize:
        return False
    with path.open("rb") as stream:
        records = np.frombuffer(stream.read(64 * RECORD.itemsize), RECORD)
    lengths = np.linalg.norm(_quats(records), axis=1)
    plausible = np.isfinite(records["mean"]).all(axis=1) & (records["scale"] >= 0).all(axis=1)
    return bool((plausible & (np.abs(lengths - 1) < QUATERNION_TOLERANCE)).mean() > 0.9)


def read_splat(path: Path, axes: Axes = "auto") -> StoredGaussians:
    """Read Gaussians; `auto` means the axes of viewers.

    Raises:
        InputError: The file is not a whole number of records, holds too many, or numbers that no Gaussian has.
    """
    size = path.stat().st_size
    if size % RECORD.itemsize or not 0 < size <= MAX_ROWS * RECORD.itemsize:
        raise InputError(
            f"{path}: expected records of {RECORD.itemsize} bytes, at most {MAX_ROWS}, found {size} bytes; the file is "
            "truncated or not a .splat file"
        )
    records = np.memmap(path, RECORD, "r")
    opacities = records["color"][:, 3] / 255
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = StoredGaussians(
            means=records["mean"].astype(np.float32),
            sh_dc=((records["color"][:, :3] / 255 - 0.5) / SH_C0).astype(np.float32),
            sh_rest=np.zeros((len(records), 0, 3), np.float32),
            opacity_logits=(np.log(opacities) - np.log1p(-opacities)).astype(np.float32),
            log_scales=np.log(np.where(records["scale"] < 0, np.nan, records["scale"]).clip(MIN_SCALE, None)),
            quats=_quats(records),
        )
    return in_our_axes(sound_rows(path, rows), axes, is_for_viewers=True)


def _quats(records: np.ndarray) -> np.ndarray:
    return (records["quat"].astype(np.float32) - 128) / 128
