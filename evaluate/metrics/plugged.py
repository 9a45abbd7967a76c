"""Metrics of other packages (`ggavatar.plugins`): a module with `METRIC` and `measure(prediction, truth, foreground)`.

A metric that fails on a frame has no value in the whole evaluation, and the reason names its package; the others are
measured all the same.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from evaluate.metrics.metric import Metric
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.plugins.entry_points import METRICS, Plugin, failure, listed, source_of
from ggavatar.text.names import clean_name, clean_text

Image = UInt8[np.ndarray, "H W 3"]
Foreground = Float[np.ndarray, "H W"] | None
Measure = Callable[[Image, Image, Foreground], float | None]
"""A value for a prediction and its ground truth (8-bit sRGB) and the person's coverage (0 to 1; None without masks);
None where there is nothing to measure. Called from several threads."""

RESERVED = ("mse", "lpips", "ssim")
"""Names that mean something in files and flags without being metrics of the catalogue."""
_FAILED = "it measured frames"


@dataclass(frozen=True)
class PluggedMetric:
    """A metric of another package.

    Attributes:
        plugin: Where it is from.
        metric: Its definition.
        measure: Its value for a pair of images.
        sha256: Of its source; results are measured again when it changes.
    """

    plugin: Plugin
    metric: Metric
    measure: Measure
    sha256: str


def plugged_names(own: Collection[str]) -> list[str]:
    """Names of the metrics of other packages, without importing any; `own` are those of the catalogue."""
    return sorted(listed(METRICS, [*own, *RESERVED]).usable)


def plugged_metric(name: str, own: Collection[str]) -> PluggedMetric | None:
    """The metric of another package; None if there is none of this name.

    Raises:
        InputError: It cannot be imported, or is not defined as it must be.
    """
    return _loaded(name, tuple(own), tuple(sys.path))


@functools.lru_cache
def _loaded(name: str, own: tuple[str, ...], path: tuple[str, ...]) -> PluggedMetric | None:
    """`plugged_metric`, for one search path of modules."""
    plugins = listed(METRICS, [*own, *RESERVED])
    if name not in plugins.usable and name not in plugins.problems:
        return None
    plugin = plugins.require(name)
    module = plugin.load("METRIC", "measure")
    source = source_of(plugin.module)
    digest = "" if source is None else sha256_of(source)
    return PluggedMetric(plugin, _checked(plugin, module.METRIC), module.measure, digest)


def _checked(plugin: Plugin, metric: object) -> Metric:
    """The definition with texts of one line; `InputError` if a field cannot be what it must be."""
    if not isinstance(metric, Metric):
        raise InputError(f"{plugin}: expected METRIC to be a Metric, found {type(metric).__name__}; tell its author")
    if metric.name != plugin.name:
        raise InputError(f"{plugin}: expected METRIC of this name, found {metric.name!r}; tell its author")
    numbers = isinstance(metric.digits, int) and 0 <= metric.digits <= 10 and math.isfinite(metric.tolerance)
    if not numbers or metric.tolerance < 0 or not metric.definition.strip():
        raise InputError(
            f"{plugin}: expected METRIC with 0 to 10 digits, a tolerance of 0 or more and a definition; tell its author"
        )
    return replace(
        metric,
        title=clean_name(metric.title),
        unit=clean_name(metric.unit),
        definition=clean_text(metric.definition),
    )


class PluggedMetrics:
    """The metrics of other packages that an evaluation measures.

    Attributes:
        hashes: SHA-256 of their sources by name.
        failed: Why a metric has no value, by name; grows while frames are measured.
    """

    def __init__(self, metrics: Sequence[PluggedMetric]) -> None:
        self._metrics = metrics
        self.hashes = {one.metric.name: one.sha256 for one in metrics}
        self.failed: dict[str, str] = {}

    def measure(self, prediction: Image, truth: Image, foreground: Foreground) -> dict[str, float | None]:
        """Values by name; those that are not finite are None. The arrays are lent out read-only."""
        lent = [None if array is None else _read_only(array) for array in (prediction, truth, foreground)]
        return {one.metric.name: self._value(one, lent) for one in self._metrics}

    def _value(self, one: PluggedMetric, arrays: list[np.ndarray | None]) -> float | None:
        name = one.metric.name
        if name in self.failed:
            return None
        try:
            found = one.measure(*arrays)  # type: ignore[arg-type]  # the first two are never None
            number = None if found is None else float(found)
        except MemoryError:
            raise
        except Exception as error:
            self.failed[name] = failure(one.plugin, _FAILED, error)
            return None
        return number if number is not None and math.isfinite(number) else None

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of their packages by name."""
        return {one.plugin.package: one.plugin.version for one in self._metrics}


def is_failure(reason: str) -> bool:
    """Whether a metric has no value because its package failed."""
    return f": failed when {_FAILED}: " in reason


def _read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view
