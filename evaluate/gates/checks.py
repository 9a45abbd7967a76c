"""Gate checks: floors, ceilings and comparison with earlier results, and their reports (JUnit, GitHub)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from evaluate.metrics.catalogue import METRICS, metric_of
from evaluate.protocols.results import Evaluation
from ggavatar.errors import InputError, nearest
from ggavatar.io.atomic import write_text


@dataclass(frozen=True)
class Check:
    """The outcome of one comparison.

    Attributes:
        case: Subject, method and metric.
        passed: Whether the limit holds.
        message: The value, the limit and the margin between them.
    """

    case: str
    passed: bool
    message: str


def parse_limits(texts: Sequence[str], flag: str) -> dict[str, float]:
    """Numbers by metric from texts such as `psnr=30`.

    Raises:
        InputError: Not METRIC=NUMBER, or an unknown metric; the message suggests the nearest name.
    """
    limits = {}
    for text in texts:
        name, equals, number = text.partition("=")
        limits[name] = _finite(number)
        if not math.isfinite(limits[name]):
            raise InputError(f"{flag}: expected METRIC=NUMBER such as psnr=30, found {text!r}")
        base = name.partition("@")[0]
        if not equals or (base not in METRICS and base not in ("ssim", "lpips")):
            suggestion = nearest(base, METRICS)
            raise InputError(f"{flag}: unknown metric {name!r}{suggestion}; known are {', '.join(METRICS)}")
    return limits


def _finite(text: str) -> float:
    """The number in a text; NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


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
    case = f"{_label(evaluation)}/{name}"
    found = evaluation.summary(name)
    if found.mean is None:
        if found.identical and sign > 0:
            return Check(case, True, f"{name} of identical images, required {limit:g}")
        return Check(case, False, f"{name} was not measured ({evaluation.missing.get(name, 'no value')})")
    margin = sign * (found.mean - limit)
    word = "floor" if sign > 0 else "ceiling"
    state = "holds by" if margin >= 0 else "is missed by"
    return Check(case, margin >= 0, f"{name} is {found.mean:.6g}, the {word} {limit:g} {state} {abs(margin):.6g}")


def _label(evaluation: Evaluation) -> str:
    """Subject and method, and the seed if known."""
    seed = "" if evaluation.seed is None else f"/seed {evaluation.seed}"
    return f"{evaluation.subject}/{evaluation.method}{seed}"


def compare_with_baselines(
    evaluations: Sequence[Evaluation], baselines: Sequence[Evaluation], tolerances: Mapping[str, float]
) -> list[Check]:
    """Check that no mean is worse than in a baseline by more than its tolerance.

    Args:
        evaluations: The new results.
        baselines: The old results; each needs a new counterpart of the same subject, method and protocol.
        tolerances: Tolerances by metric; the default is that of `evaluate.metrics.catalogue`.

    Raises:
        InputError: The protocols differ, so the numbers are not comparable.
    """
    checks = []
    for old in baselines:
        named = [e for e in evaluations if (e.subject, e.method) == (old.subject, old.method)]
        matching = [e for e in named if e.protocol.digest == old.protocol.digest and e.seed in (old.seed, None)]
        matching = matching or [e for e in named if e.protocol.digest == old.protocol.digest]
        if named and not matching:
            raise InputError(
                f"baseline {old.subject}/{old.method} was scored under {old.protocol.id} ({old.protocol.digest[:12]}), "
                f"now under {named[0].protocol.id} ({named[0].protocol.digest[:12]}); "
                "such numbers are not comparable; score with the baseline's protocol"
            )
        if not matching:
            checks.append(Check(_label(old), False, "is in the baseline but was not evaluated"))
            continue
        limits = {full_metric_name(name, old): value for name, value in tolerances.items()}
        checks += [_against_baseline(matching[0], old, name, limits) for name in old.columns if _has(old, name)]
    return checks


def _has(evaluation: Evaluation, name: str) -> bool:
    found = evaluation.summary(name)
    return found.mean is not None or found.identical > 0


def _against_baseline(new: Evaluation, old: Evaluation, name: str, limits: Mapping[str, float]) -> Check:
    case = f"{_label(new)}/{name}"
    metric = metric_of(name)
    before, now = old.summary(name), new.summary(name)
    if now.mean is None:
        reason = new.missing.get(name, "no value")
        return Check(case, now.identical > 0, f"{name} was {before.mean} and is not measured now ({reason})")
    if before.mean is None:
        return Check(case, False, f"{name} was infinite (identical images) and is {now.mean:.6g}")
    tolerance = limits.get(name, metric.tolerance)
    change = now.mean - before.mean if metric.higher_is_better else before.mean - now.mean
    moved = new.hashes.get("ground_truth") != old.hashes.get("ground_truth")
    words = f"{name} was {before.mean:.6g} and is {now.mean:.6g}" + (" (of another ground truth)" if moved else "")
    state = f"worse by {-change:.6g}" if change < 0 else f"better by {change:.6g}"
    return Check(case, change >= -tolerance, f"{words}: {state}, tolerance {tolerance:g}")


def to_junit(checks: Sequence[Check]) -> str:
    """Checks as JUnit XML, one test case per check."""
    failures = sum(not check.passed for check in checks)
    root = ElementTree.Element("testsuites")
    suite = ElementTree.SubElement(
        root, "testsuite", name="ggavatar-eval", tests=str(len(checks)), failures=str(failures)
    )
    for check in checks:
        group, _, name = check.case.rpartition("/")
        case = ElementTree.SubElement(suite, "testcase", classname=group or "ggavatar-eval", name=name)
        if check.passed:
            ElementTree.SubElement(case, "system-out").text = check.message
        else:
            ElementTree.SubElement(case, "failure", message=check.message).text = f"{check.case}: {check.message}"
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def to_github(checks: Sequence[Check]) -> str:
    """Checks as GitHub workflow commands, shown as annotations."""
    return "".join(
        f"::{'notice' if check.passed else 'error'} title={_property(check.case)}::{_message(check.message)}\n"
        for check in checks
    )


def _message(text: str) -> str:
    """Text escaped for the message of a workflow command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    """Text escaped for a property of a workflow command."""
    return _message(text).replace(":", "%3A").replace(",", "%2C")


def write_junit(path: Path, checks: Sequence[Check]) -> None:
    """Write the JUnit file."""
    write_text(path, to_junit(checks))
