"""The catalogue of metrics: name, exact definition (part of a protocol's digest) and presentation in tables.

`METRICS` are ours; the functions also know those of other packages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from evaluate.metrics.metric import Metric
from evaluate.metrics.plugged import PluggedMetric, PluggedMetrics, plugged_metric, plugged_names
from ggavatar.errors import InputError, nearest

# The definitions below enter the digests of published protocols: their wording must not change, terms such as "render"
# and "truth" included (elsewhere: prediction, ground truth).
_WINDOW = "11x11 Gaussian window of sigma 1.5, population covariance, K1 = 0.01, K2 = 0.03, range 1"
_LUMA = "on 0.299 R + 0.587 G + 0.114 B"
_NO_FACE = "frames without a face in render or truth are left out and counted"
_LANDMARKS = (
    "the 478 landmarks of MediaPipe's face landmarker, in distances between the outer corners of the truth's eyes; "
    f"{_NO_FACE}"
)
_SIGNED, _UNIT = "[-1, 1]", "[0, 1] without the shift the weights were made for, as in 3DGS code"


def _ssim(name: str, title: str, words: str) -> Metric:
    return Metric(name, title, True, 3, "1", words, 0.002)


def _lpips(name: str, title: str, network: str, value_range: str) -> Metric:
    words = f"LPIPS v0.1 on torchvision's {network} features, spatial mean, summed over layers; RGB in {value_range}"
    return Metric(name, title, False, 3, "1", words, 0.003)


def _error(name: str, title: str, words: str, tolerance: float = 0.02) -> Metric:
    """An error whose size depends on the subject, so that its tolerance is a fraction of it."""
    return Metric(name, title, False, 4, "1", words, tolerance, relative_tolerance=True)


_METRICS = (
    Metric(
        "psnr",
        "PSNR",
        True,
        2,
        "dB",
        "10 log10(1 / MSE) of each image over all pixels and channels; identical images are counted apart",
        0.1,
    ),
    Metric("psnr_pooled", "PSNR (pooled)", True, 2, "dB", "10 log10(1 / mean over the images of their MSE)", 0.1),
    _error("l1", "L1", "mean absolute difference over all pixels and channels, range 1"),
    _ssim("ssim", "SSIM", f"Wang et al. 2004: {_WINDOW}, valid region only, mean over R, G and B"),
    _ssim("ssim_luma", "SSIM (luma)", f"Wang et al. 2004: {_WINDOW}, valid region only, {_LUMA}"),
    _ssim("ssim_3dgs", "SSIM (3DGS)", f"{_WINDOW}, images padded with 5 px of zeros, mean over R, G and B"),
    _ssim("ssim_3dgs_luma", "SSIM (3DGS, luma)", f"{_WINDOW}, images padded with 5 px of zeros, {_LUMA}"),
    _ssim(
        "ms_ssim",
        "MS-SSIM",
        f"Wang et al. 2003: weights .0448 .2856 .3001 .2363 .1333, {_WINDOW}, valid region, 2x2 means, RGB mean",
    ),
    _lpips("lpips_alex", "LPIPS", "AlexNet", _SIGNED),
    _lpips("lpips_vgg", "LPIPS (VGG)", "VGG16", _SIGNED),
    _lpips("lpips_squeeze", "LPIPS (Squeeze)", "SqueezeNet 1.1", _SIGNED),
    _lpips("lpips_alex_unit_range", "LPIPS (Alex, [0,1])", "AlexNet", _UNIT),
    _lpips("lpips_vgg_unit_range", "LPIPS (VGG, [0,1])", "VGG16", _UNIT),
    _error(
        "frame_difference",
        "Δ frames",
        "mean of |(render[t] - render[t-1]) - (truth[t] - truth[t-1])| over pixels and channels, range 1, where source "
        "frames t-1 and t are both scored",
    ),
    _error(
        "flicker",
        "Flicker",
        "mean of |render[t] - render[t-1]| over pixels where no channel of the truth changes by more than 2/255 and "
        "the mask, if there is one, covers half or more in t-1 and t; range 1",
        0.05,
    ),
    _error(
        "landmark_distance",
        "Landmarks",
        f"mean distance between render and truth of {_LANDMARKS}",
        0.05,
    ),
    _error(
        "landmark_jitter",
        "Jitter",
        f"mean |e[t-2] - 2 e[t-1] + e[t]|, e the error of {_LANDMARKS}; source frames t-2 to t all scored",
        0.05,
    ),
    _error(
        "expression_distance",
        "AED",
        "mean |difference| between render and truth of the 51 expression scores in [0, 1] (the blendshapes without "
        f"'neutral') of MediaPipe's face landmarker; {_NO_FACE}",
        0.05,
    ),
    Metric(
        "identity",
        "CSIM",
        True,
        3,
        "1",
        "cosine of the SFace embeddings of render and truth, each aligned by eyes, nose and corners of the mouth among "
        f"its own landmarks of MediaPipe's face landmarker; {_NO_FACE}",
        0.01,
    ),
)

METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for metric in _METRICS})
TEMPORAL = ("frame_difference", "flicker")
FACES = ("landmark_distance", "landmark_jitter", "expression_distance", "identity")
REGION_METRICS = ("psnr", "l1", "ssim", "ssim_luma", "ssim_3dgs", "ssim_3dgs_luma")
"""Metrics that can be restricted to a region, `NAME@REGION`."""

REGION_DEFINITION = (
    "mask-weighted mean: sum of weight x squared (or absolute) error over 3 sum of weights; "
    "SSIM: its map averaged with the same weights"
)


def metric_names() -> list[str]:
    """Names of all metrics, those of other packages last; imports none of them."""
    return [*METRICS, *plugged_names(METRICS)]


def find_metric(name: str) -> Metric | None:
    """The metric of a name without a region; None if there is none.

    Raises:
        InputError: It is that of another package and cannot be imported.
    """
    if name in METRICS:
        return METRICS[name]
    found = plugged_metric(name, METRICS)
    return None if found is None else found.metric


def require_metric(name: str, flag: str = "") -> Metric:
    """The metric of a name without a region.

    Args:
        name: The name.
        flag: What the name was given to, for the message.

    Raises:
        InputError: There is none, and the message suggests the nearest name; or as in `find_metric`.
    """
    found = find_metric(name)
    if found is None:
        known, where = metric_names(), f"{flag}: " if flag else ""
        raise InputError(
            f"{where}unknown metric {name!r}{nearest(name, known)}; known are {', '.join(known)}. Install the package "
            "of a metric that is not among them"
        )
    return found


def plugged_metrics(names: Sequence[str]) -> PluggedMetrics:
    """Those of the named metrics that are of other packages, ready to measure."""
    found = [plugged_metric(name, METRICS) for name in names if name not in METRICS]
    return PluggedMetrics([one for one in found if isinstance(one, PluggedMetric)])


def metric_of(name: str) -> Metric:
    """The metric of a column name; a region after `@` is ignored.

    Raises:
        InputError: Unknown metric.
    """
    return require_metric(name.partition("@")[0])


def title_of(name: str) -> str:
    """Column heading of a metric name with or without a region."""
    _, _, region = name.partition("@")
    return metric_of(name).title + (f" {region}" if region else "")
