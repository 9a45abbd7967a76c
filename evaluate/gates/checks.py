"""Gate checks: floors and ceilings of means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluate.gates.baselines import label_of
from evaluate.gates.tolerances import check_metric, finite
from evaluate.metrics.catalogue import METRICS, find_metric
from evaluate.protocols.results import Evaluation
from ggavatar.errors import InputError


@dataclass(frozen=True)
class Check:
    """The outcome of one comparison.

    Attributes:
        case: Subject, method and metric.
        passed: Whether the limit holds.
        message: The value, the limit and the margin between them.
        rule: What the metric is held against, such as `floor`: one metric can have several checks.
    """

    case: str
    passed: bool
    message: str
    rule: str = ""


def parse_limits(texts: Sequence[str], flag: str) -> dict[str, float]:
    """Numbers by metric from texts such as `psnr=30`.

    Args:
        texts: METRIC=NUMBER.
        flag: `--fail-below`, for metrics of which higher is better, or `--fail-above`, for the others.

    Raises:
        InputError: Not METRIC=NUMBER, or an unknown metric; the message suggests the nearest name. Or a limit that the
            best results would miss; the message names the other flag.
    """
    limits = {}
    for text in texts:
        name, _, number = text.partition("=")
        limits[name] = finite(number)
        if math.isnan(limits[name]):
            raise InputError(f"{flag}: expected METRIC=NUMBER such as psnr=30, found {text!r}")
        check_metric(name, flag)
        _check_direction(name, number, flag)
    return limits


def _check_direction(name: str, number: str, flag: str) -> None:
    """Raise `InputError` if a metric is limited from its good side."""
    base = name.partition("@")[0]
    metric = find_metric(base) or next(metric for metric in METRICS.values() if metric.name.startswith(base))
    higher = metric.higher_is_better
    right = "--fail-below" if higher else "--fail-above"
    if flag != right:
        word = "higher" if higher else "lower"
        raise InputError(f"{flag}: {name} is {word}-is-better, found {name}={number}; use {right} {name}={number}")


def full_metric_name(name: str, evaluation: Evaluation) -> str:
    """A metric's full name: `ssim` and `lpips` mean the variant in the protocol's main table."""
    if name in evaluation.columns:
        return name
    family = [metric for metric in evaluation.protocol.table_metrics if metric.startswith(name)]
    if len(family) != 1:
        raise InputError(
            f"{evaluation.protocol.id} does not measure {name!r}; it measures {', '.join(evaluation.columns)}"
        )
    return family[0]


def check_limits(
    evaluations: Sequence[Evaluation], floors: Mapping[str, float], ceilings: Mapping[str, float]
) -> list[Check]:
    """Check that every mean reaches its floor and stays below its ceiling; a metric without a value fails."""
    checks = []
    for evaluation in evaluations:
        for limits, sign in ((floors, 1), (ceilings, -1)):
            for wanted, limit in limits.items():
                checks.append(_against_limit(evaluation, full_metric_name(wanted, evaluation), limit, sign))
    return checks


def _against_limit(evaluation: Evaluation, name: str, limit: float, sign: int) -> Check:
    case = f"{label_of(evaluation.subject, evaluation.method, evaluation.seed)}/{name}"
    found = evaluation.summary(name)
    word = "floor" if sign > 0 else "ceiling"
    if found.mean is None:
        if found.identical and sign > 0:
            return Check(case, True, f"{name} of identical images, required {limit:g}", word)
        return Check(case, False, f"{name} was not measured ({evaluation.missing.get(name, 'no value')})", word)
    margin = sign * (found.mean - limit)
    state = "holds by" if margin >= 0 else "is missed by"
    return Check(case, margin >= 0, f"{name} is {found.mean:.6g}, the {word} {limit:g} {state} {abs(margin):.6g}", word)
