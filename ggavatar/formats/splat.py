"""Writer of `.splat` (antimatter15): 32 bytes per Gaussian, no header, no view-dependent color."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.formats.stored_gaussians import StoredGaussians, rotate_180_about_x
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.io.atomic import write_atomically

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
