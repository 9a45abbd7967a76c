"""Comparison with baselines: like is compared with like, and nothing may be worse by more than its tolerance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from evaluate.gates.baselines import Baseline, baseline_of
from evaluate.gates.checks import Check, full_metric_name
from evaluate.gates.tolerances import Tolerance, tolerance_of
from evaluate.metrics.catalogue import metric_of
from evaluate.protocols.results import Evaluation
from evaluate.protocols.setup import NOT_RECORDED
from ggavatar.errors import InputError

RULE = "against baseline"


def compare_with_baselines(
    evaluations: Sequence[Evaluation],
    baselines: Sequence[Baseline],
    tolerances: Mapping[str, Tolerance],
    allowed: Collection[str] = (),
) -> list[Check]:
    """Check that no mean is worse than in a baseline by more than its tolerance.

    Args:
        evaluations: The new results.
        baselines: The old results; each needs a new counterpart of the same subject and method, or of another method
            if `allowed` has it. Of several under different protocols, only those under the protocol of the new results
            are compared.
        tolerances: Tolerances by metric; the default is that of `evaluate.metrics.catalogue`.
        allowed: What may differ, by name: keys of `differences`.

    Raises:
        InputError: Something differs that makes the numbers incomparable and is not allowed.
    """
    checks = []
    for old in _comparable(evaluations, baselines):
        matching = _counterparts(evaluations, old, old.method)
        others = _other_methods(evaluations, baselines, old) if not matching else []
        if not matching and not others:
            checks.append(Check(old.label, False, "is in the baseline but was not evaluated"))
        for new in matching[:1] or [_counterparts(evaluations, old, method)[0] for method in others]:
            checks += _against_one(new, old, tolerances, allowed)
    return checks


def _against_one(
    new: Evaluation, old: Baseline, tolerances: Mapping[str, Tolerance], allowed: Collection[str]
) -> list[Check]:
    """Every mean of a baseline against its counterpart, or `InputError` if they are not alike."""
    found = differences(baseline_of(new), old)
    if refused := [name for name in found if name not in allowed]:
        raise InputError(
            f"{old.label}: differs from the baseline in {'; '.join(found[name] for name in refused)}: such numbers "
            f"are not comparable; compare with a baseline of the same, or pass --allow-other {' '.join(refused)}"
        )
    limits = {full_metric_name(name, new): value for name, value in tolerances.items()}
    names = [name for name in old.means if "protocol" not in found or name in new.columns]
    remark = _remark(found, old.seed, new.seed)
    return [_against_baseline(new, old, name, limits, remark) for name in names]


def _remark(found: Collection[str], then: int | None, now: int | None) -> str:
    """What differs although it is compared, for the end of a message; empty if nothing does."""
    seeds = ["none" if seed is None else str(seed) for seed in (then, now)]
    words = [name.replace("-", " ") for name in found] + (["seed"] if then != now else [])
    return f" (another {', '.join(words)}{f': {seeds[0]} then, {seeds[1]} now' * (then != now)})" if words else ""


def _comparable(evaluations: Sequence[Evaluation], baselines: Sequence[Baseline]) -> list[Baseline]:
    """The baselines without those under other protocols of evaluations that are there under the right one too."""
    digests = {e.protocol.digest for e in evaluations}
    named = {(b.subject, b.method, b.seed) for b in baselines if b.digest in digests}
    return [b for b in baselines if b.digest in digests or (b.subject, b.method, b.seed) not in named]


def _other_methods(evaluations: Sequence[Evaluation], baselines: Sequence[Baseline], old: Baseline) -> list[str]:
    """New methods on a baseline's subject that no baseline has: they stand where its method stood."""
    known = {(b.subject, b.method) for b in baselines}
    return list(
        dict.fromkeys(e.method for e in evaluations if e.subject == old.subject and (e.subject, e.method) not in known)
    )


def _counterparts(evaluations: Sequence[Evaluation], old: Baseline, method: str) -> list[Evaluation]:
    """New evaluations of a baseline's subject by a method: of the same protocol and seed if there are any."""
    found = [e for e in evaluations if (e.subject, e.method) == (old.subject, method)]
    found = [e for e in found if e.protocol.digest == old.digest] or found
    return [e for e in found if e.seed in (old.seed, None)] or found


def differences(new: Baseline, old: Baseline) -> dict[str, str]:
    """What makes two results incomparable, in words by name; a setup that was not recorded differs from none."""
    found = {}
    if new.method != old.method:
        found["method"] = f"method ({old.method} then, {new.method} now)"
    if new.digest != old.digest:
        found["protocol"] = f"protocol ({old.protocol}, {old.digest[:12]} then; {new.protocol}, {new.digest[:12]} now)"
    if new.ground_truth and old.ground_truth and new.ground_truth != old.ground_truth:
        found["ground-truth"] = f"ground truth (SHA-256 {old.ground_truth[:12]} then, {new.ground_truth[:12]} now)"
    if "not recorded" in (new.setup.origin, old.setup.origin):
        return found
    then, now = _setup_facts(old), _setup_facts(new)
    for name in then:
        if then[name] != now[name] and not (name == "tracking" and NOT_RECORDED in (then[name], now[name])):
            found[name] = f"{name} ({then[name]} then, {now[name]} now)"
    return found


def _setup_facts(one: Baseline) -> dict[str, str]:
    facts, setup = one.setup.facts, one.setup
    return {
        "method": setup.method or setup.describe(),
        "preset": facts.get("preset", "none"),
        "length": facts.get("length", "none"),
        "features": facts.get("perceptual loss", "none"),
        "settings": facts.get("changed settings", "none"),
        "tracking": facts.get("tracking", "none"),
    }


def _against_baseline(new: Evaluation, old: Baseline, name: str, limits: Mapping[str, Tolerance], remark: str) -> Check:
    case = f"{baseline_of(new).label}/{name}"
    before, now = old.means[name], new.summary(name)
    if now.mean is None:
        reason = new.missing.get(name, "no value")
        return Check(case, now.identical > 0, f"{name} was {before} and is not measured now ({reason}){remark}", RULE)
    if before is None:
        return Check(case, False, f"{name} was infinite (identical images) and is {now.mean:.6g}{remark}", RULE)
    tolerance = tolerance_of(name, limits)
    change = now.mean - before if metric_of(name).higher_is_better else before - now.mean
    state = f"worse by {-change:.6g}" if change < 0 else f"better by {change:.6g}"
    words = f"{name} was {before:.6g} and is {now.mean:.6g}: {state}, {tolerance.words(before)}{remark}"
    return Check(case, change >= -tolerance.allowed(before), words, RULE)
