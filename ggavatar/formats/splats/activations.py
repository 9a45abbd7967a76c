"""Whether a file stores scales as logarithms and opacities as logits, as 3DGS does, or as they are.

Both are decided from all values together, since a file does not say it. Logarithms of scales in meters are negative,
but for Gaussians of a meter and more; logits of opacities lie on both sides of [0, 1] in any trained file.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ggavatar.formats.splats.stored_gaussians import MIN_OPACITY, MIN_SCALE

ScaleKind = Literal["auto", "log", "linear"]
OpacityKind = Literal["auto", "logit", "linear"]

LARGEST_RELATIVE_SCALE = 1 / 8
"""Nine of ten Gaussians of a usable file have deviations below this fraction of the extent of all positions."""


def log_scales(
    scales: Float[ndarray, "N C"], means: Float[ndarray, "N 3"], kind: ScaleKind
) -> tuple[Float[ndarray, "N C"], tuple[str, ...]]:
    """Natural logarithms of scales as a file stores them, and a note where they were not logarithms."""
    if kind == "log" or (kind == "auto" and not _are_linear_scales(scales, means)):
        return scales, ()
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(np.where(scales < 0, np.nan, scales.clip(MIN_SCALE, None)))
    note = "its scales are lengths, not logarithms, and are read as that; --scales log reads them as logarithms"
    return logs.astype(np.float32), (note,) if kind == "auto" else ()


def _are_linear_scales(scales: ndarray, means: ndarray) -> bool:
    """Whether all scales are positive, and as logarithms would be far too large for the extent of the positions."""
    sound = np.isfinite(scales).all(axis=1) & np.isfinite(means).all(axis=1)
    if not sound.any() or float(scales[sound].min()) < 0:
        return False
    largest = float(np.exp(np.quantile(scales[sound].max(axis=1), 0.9, method="lower").clip(None, 50)))
    low, high = np.quantile(means[sound], (0.02, 0.98), axis=0)
    extent = float((high - low).max())
    return extent > 0 and largest > LARGEST_RELATIVE_SCALE * extent


def opacity_logits(opacities: Float[ndarray, " N"], kind: OpacityKind) -> tuple[Float[ndarray, " N"], tuple[str, ...]]:
    """Logits of opacities as a file stores them, and a note where they were not logits."""
    if kind == "logit" or (kind == "auto" and not _are_linear_opacities(opacities)):
        return opacities, ()
    values = opacities.astype(np.float64)
    values = np.where((values < 0) | (values > 1), np.nan, values.clip(MIN_OPACITY, 1 - MIN_OPACITY))
    note = "its opacities are in 0 to 1, not logits, and are read as that; --opacities logit reads them as logits"
    return np.log(values / (1 - values)).astype(np.float32), (note,) if kind == "auto" else ()


def _are_linear_opacities(opacities: ndarray) -> bool:
    """Whether all lie in [0, 1] and differ: as logits they would all be opacities of 0.50 to 0.73."""
    sound = opacities[~np.isnan(opacities)]
    return bool(sound.size) and 0 <= float(sound.min()) < float(sound.max()) <= 1
