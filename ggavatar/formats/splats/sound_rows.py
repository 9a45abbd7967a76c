"""Gaussians that no renderer can draw (NaN, zero quaternions, absurd numbers): dropped and counted, if they are few."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.stored_gaussians import StoredGaussians

MAX_BROKEN_FRACTION = 0.01
"""A file with a larger fraction of broken rows is refused: not a few rows but the file is wrong."""
MAX_POSITION, MAX_COEFFICIENT, MIN_LOG_SCALE, MAX_LOG_SCALE = 1e6, 1e4, -100.0, 14.0
"""Limits on positions (m), coefficients and logarithms of scales (m); numbers beyond them mean a damaged row."""
MAX_OPACITY_LOGIT = 80.0
"""Logits of opacities are clipped to this; beyond it an opacity is 0 or 1 in float32."""
MIN_QUATERNION_LENGTH = 1e-6


def sound_rows(path: Path, rows: StoredGaussians) -> StoredGaussians:
    """The rows that are Gaussians, with a note on those that are not.

    Logits of opacities may be infinite, as in files converted from formats with one byte per opacity.

    Raises:
        InputError: More than `MAX_BROKEN_FRACTION` of the rows are broken.
    """
    logits = rows.opacity_logits.clip(-MAX_OPACITY_LOGIT, MAX_OPACITY_LOGIT)
    rows = dataclasses.replace(rows, opacity_logits=logits)
    broken = np.zeros(len(rows), bool)
    found = []
    for reason, mask in _reasons(rows).items():
        count = int((mask & ~broken).sum())
        found += [f"{count} with {reason}"] if count else []
        broken |= mask
    if not found:
        return rows
    count = int(broken.sum())
    if count > MAX_BROKEN_FRACTION * len(rows):
        raise InputError(
            f"{path}: expected sound numbers in at least {1 - MAX_BROKEN_FRACTION:.0%} of the Gaussians, found "
            f"{count} of {len(rows)} broken ({', '.join(found)}; first in row {int(broken.argmax())}); the file is "
            "damaged or does not hold 3D Gaussians, export it again"
        )
    kept = {name: value[~broken] for name, value in vars(rows).items() if isinstance(value, ndarray)}
    note = f"dropped {count} of {len(rows)} Gaussians: {', '.join(found)}"
    return dataclasses.replace(rows, **kept, notes=(*rows.notes, note))


def _reasons(rows: StoredGaussians) -> dict[str, Bool[ndarray, " N"]]:
    """The rows that are broken, by what is wrong with them."""
    numbers = (rows.means, rows.log_scales, rows.quats, rows.sh_dc, rows.sh_rest.reshape(len(rows), -1))
    undefined = np.isnan(rows.opacity_logits)
    for values in numbers:
        undefined |= ~np.isfinite(values).all(axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(rows.quats.astype(np.float64), axis=1)
        return {
            "NaN or infinity": undefined,
            "a rotation of length zero": length < MIN_QUATERNION_LENGTH,
            f"positions beyond ±{MAX_POSITION:g} m": _beyond(rows.means, MAX_POSITION),
            "scales that no Gaussian has": (rows.log_scales < MIN_LOG_SCALE).any(axis=1)
            | (rows.log_scales > MAX_LOG_SCALE).any(axis=1),
            f"colors beyond ±{MAX_COEFFICIENT:g}": _beyond(rows.sh_dc, MAX_COEFFICIENT),
            f"harmonics beyond ±{MAX_COEFFICIENT:g}": _beyond(rows.sh_rest.reshape(len(rows), -1), MAX_COEFFICIENT),
            f"rotations beyond ±{MAX_POSITION:g}": _beyond(rows.quats, MAX_POSITION),
        }


def _beyond(values: ndarray, limit: float) -> Bool[ndarray, " N"]:
    return (np.abs(values) > limit).any(axis=1)
