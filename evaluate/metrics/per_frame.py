"""All pixel metrics of one frame, computed together so that intermediate maps are shared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set

import numpy as np
from jaxtyping import Float, UInt8

from evaluate.metrics import pixels, ssim

Weights = Float[np.ndarray, "H W"]
Image = UInt8[np.ndarray, "H W 3"]
Value = float | None

SSIM_NAMES = ("ssim", "ssim_luma", "ssim_3dgs", "ssim_3dgs_luma")


def measure_pixels(
    prediction: Image, truth: Image, columns: Sequence[str], regions: Mapping[str, Weights]
) -> dict[str, Value]:
    """Pixel metrics of one pair of images.

    Args:
        prediction: Rendered image.
        truth: Ground truth.
        columns: Names to measure, with `@region` for masked ones; other than pixel metrics are ignored.
        regions: Weights in [0, 1] by region.

    Returns:
        Values by column. The PSNR of identical images is infinite; None means an empty or absent mask, or an image
        too small for the metric.
    """
    maps = _ssim_maps(prediction, truth, columns)
    masked = {column.partition("@")[0] for column in columns if "@" in column}
    flat = {name: maps[name].mean(axis=2, dtype=np.float64) for name in masked & set(maps)}
    flat |= _error_maps(prediction, truth, masked)
    values: dict[str, Value] = {}
    for column in columns:
        name, _, region = column.partition("@")
        if region:
            values[column] = _masked(name, flat, regions.get(region))
        elif name in SSIM_NAMES:
            values[column] = float(maps[name].mean(dtype=np.float64)) if name in maps else None
        elif name in _WHOLE:
            values[column] = _WHOLE[name](prediction, truth)
    return values


def _ms_ssim(prediction: Image, truth: Image) -> Value:
    large = min(prediction.shape[:2]) > ssim.MS_MIN_SIDE
    return ssim.ms_ssim(prediction, truth) if large else None


_WHOLE: Mapping[str, Callable[[Image, Image], Value]] = {
    "psnr": pixels.psnr,
    "mse": pixels.mean_squared_error,
    "l1": pixels.mean_absolute_error,
    "ms_ssim": _ms_ssim,
}


def _ssim_maps(prediction: Image, truth: Image, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """The SSIM maps that the columns need; valid maps are cropped from padded ones, so each pair is filtered once."""
    names = {column.partition("@")[0] for column in columns} & set(SSIM_NAMES)
    if min(prediction.shape[:2]) < ssim.WINDOW:
        names -= {"ssim", "ssim_luma"}
    found: dict[str, np.ndarray] = {}
    for color, suffix in ((True, ""), (False, "_luma")):
        if wanted := names & {f"ssim{suffix}", f"ssim_3dgs{suffix}"}:
            pair = (prediction, truth) if color else (ssim.luma(prediction), ssim.luma(truth))
            whole = ssim.ssim_map(*pair)
            found[f"ssim_3dgs{suffix}"] = whole
            if f"ssim{suffix}" in wanted:
                found[f"ssim{suffix}"] = ssim.valid(whole)
    return found


def _error_maps(prediction: Image, truth: Image, names: Set[str]) -> dict[str, np.ndarray]:
    """The error maps that masked columns need."""
    found = {"l1": pixels.absolute_error(prediction, truth)} if "l1" in names else {}
    return found | ({"mse": pixels.squared_error(prediction, truth)} if names & {"psnr", "mse"} else {})


def _masked(name: str, maps: Mapping[str, np.ndarray], weights: Weights | None) -> Value:
    """The mean of a map over a region; None if there is no mask or no map."""
    if weights is None:
        return None
    if name == "psnr":
        return pixels.masked_psnr(maps["mse"], weights)
    if name not in maps:
        return None
    radius = ssim.RADIUS if name in ("ssim", "ssim_luma") else 0
    height, width = weights.shape
    return pixels.masked_mean(maps[name], weights[radius : height - radius, radius : width - radius])
