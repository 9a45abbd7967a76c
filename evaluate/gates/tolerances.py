"""How much worse a mean may be than a baseline: absolute, or a fraction of the earlier value."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluate.metrics.catalogue import metric_of, require_metric
from ggavatar.errors import InputError

REGION_FACTOR = 2.0
"""Tolerances of regions relative to those of whole images: a region has fewer pixels, so its mean varies more."""


@dataclass(frozen=True)
class Tolerance:
    """A tolerance.

    Attributes:
        amount: In the metric's unit, or as a fraction of the earlier mean.
        relative: Whether it is a fraction.
    """

    amount: float
    relative: bool = False

    def allowed(self, before: float) -> float:
        """How much worse a mean may be than `before`, in the metric's unit."""
        return self.amount * abs(before) if self.relative else self.amount

    def words(self, before: float) -> str:
        """The tolerance for a message."""
        found = f"tolerance {self.allowed(before):.3g}"
        return f"{found} ({self.amount * 100:g} %)" if self.relative else found


def parse_tolerances(texts: Sequence[str]) -> dict[str, Tolerance]:
    """Tolerances by metric from texts such as `psnr=0.1` or `l1=2%`.

    Raises:
        InputError: Not METRIC=NUMBER or METRIC=NUMBER%, or an unknown metric; the message suggests the nearest name.
    """
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        check_metric(name, "--tolerance")
        relative = number.endswith("%")
        amount = finite(number.removesuffix("%"))
        if not amount >= 0:
            raise InputError(f"--tolerance: expected METRIC=NUMBER such as psnr=0.1 or l1=2%, found {text!r}")
        found[name] = Tolerance(amount / 100, True) if relative else Tolerance(amount)
    return found


def check_metric(name: str, flag: str) -> None:
    """Raise `InputError` unless a name is that of a metric, of a metric in a region, or `ssim` or `lpips`."""
    base = name.partition("@")[0]
    if base != "lpips":  # `ssim` is the name of a metric too
        require_metric(base, flag)


def finite(text: str) -> float:
    """The number in a text; NaN if it is no finite number."""
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def tolerance_of(name: str, given: Mapping[str, Tolerance]) -> Tolerance:
    """The tolerance of a column: as given for it, else that of its metric, for a region `REGION_FACTOR` times.

    Args:
        name: Full name of the column, such as `psnr@face`.
        given: Tolerances that the user named, by full name.
    """
    if name in given:
        return given[name]
    base, at, _ = name.partition("@")
    metric = metric_of(base)
    whole = given.get(base, Tolerance(metric.tolerance, metric.relative_tolerance))
    return Tolerance(whole.amount * (REGION_FACTOR if at else 1.0), whole.relative)
