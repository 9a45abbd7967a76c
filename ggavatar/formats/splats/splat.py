"""`.splat` (antimatter15): 32 bytes per Gaussian, no header, no view-dependent color."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.formats.splats.axes import Axes, in_our_axes
from ggavatar.formats.splats.file_kinds import SPLAT_RECORD, splat_quats
from ggavatar.formats.splats.ply import MAX_ROWS
from ggavatar.formats.splats.sound_rows import sound_rows
from ggavatar.formats.splats.stored_gaussians import MIN_SCALE, StoredGaussians, rotate_180_about_x
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.io.atomic import write_atomically
from ggavatar.io.regular_files import regular_size


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
    records = np.zeros(len(rows), SPLAT_RECORD)
    records["mean"] = rows.means[order]
    records["scale"] = np.exp(rows.log_scales[order])
    records["color"][:, :3] = _byte((0.5 + SH_C0 * rows.sh_dc[order]) * 255)
    records["color"][:, 3] = _byte(opacities[order] * 255)
    unit = rows.quats / np.linalg.norm(rows.quats, axis=1, keepdims=True)
    records["quat"] = _byte(unit[order] * 128 + 128)
    write_atomically(path, lambda stream: stream.write(records.tobytes()))


def _byte(values: np.ndarray) -> np.ndarray:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def read_splat(path: Path, axes: Axes = "auto") -> StoredGaussians:
    """Read Gaussians; `auto` means the axes of viewers.

    Raises:
        InputError: The file is not a whole number of records, holds too many, or numbers that no Gaussian has.
    """
    size = regular_size(path, "a .splat file")
    if size % SPLAT_RECORD.itemsize or not 0 < size <= MAX_ROWS * SPLAT_RECORD.itemsize:
        raise InputError(
            f"{path}: expected up to {MAX_ROWS} records of {SPLAT_RECORD.itemsize} bytes, found {size} bytes; the file "
            "is truncated or not a .splat file"
        )
    records = np.memmap(path, SPLAT_RECORD, "r")
    opacities = records["color"][:, 3] / 255
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = StoredGaussians(
            means=records["mean"].astype(np.float32),
            sh_dc=((records["color"][:, :3] / 255 - 0.5) / SH_C0).astype(np.float32),
            sh_rest=np.zeros((len(records), 0, 3), np.float32),
            opacity_logits=(np.log(opacities) - np.log1p(-opacities)).astype(np.float32),
            log_scales=np.log(np.where(records["scale"] < 0, np.nan, records["scale"]).clip(MIN_SCALE, None)),
            quats=splat_quats(records),
        )
    return in_our_axes(sound_rows(path, rows), axes, is_for_viewers=True)
