"""The gates of a command: validated before any work starts, applied to the results at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluate.gates.baselines import Baseline, read_baselines
from evaluate.gates.checks import Check, check_limits, parse_limits
from evaluate.gates.regressions import compare_with_baselines
from evaluate.gates.tolerances import Tolerance, parse_tolerances
from evaluate.options import Gates
from evaluate.protocols.results import Evaluation
from ggavatar.errors import InputError


@dataclass(frozen=True)
class Limits:
    """Limits that results must satisfy.

    Attributes:
        floors: Smallest allowed means by metric.
        ceilings: Largest allowed means by metric.
        baselines: Earlier results that the new ones must not be worse than.
        tolerances: How much worse a mean may be, by metric.
        allowed: What may differ between the results and a baseline, by name.
    """

    floors: Mapping[str, float]
    ceilings: Mapping[str, float]
    baselines: Sequence[Baseline]
    tolerances: Mapping[str, Tolerance]
    allowed: Sequence[str] = ()

    def checks(self, evaluations: Sequence[Evaluation]) -> list[Check]:
        """The outcome of every comparison."""
        checks = check_limits(evaluations, self.floors, self.ceilings)
        return checks + compare_with_baselines(evaluations, self.baselines, self.tolerances, self.allowed)


def read_limits(gates: Gates) -> Limits:
    """Read the limits from the options.

    Raises:
        InputError: A limit or a baseline cannot be read, or a report is requested without a gate.
    """
    if (gates.tolerance or gates.allow_other) and not gates.compare:
        flag = "--tolerance" if gates.tolerance else "--allow-other"
        raise InputError(f"{flag}: expected --compare FILE as well, found none; pass a run, metrics.json or baseline")
    if (gates.junit or gates.github) and not (gates.fail_below or gates.fail_above or gates.compare):
        raise InputError("--junit, --github: expected --fail-below, --fail-above or --compare to report, found none")
    return Limits(
        parse_limits(gates.fail_below, "--fail-below"),
        parse_limits(gates.fail_above, "--fail-above"),
        [baseline for path in gates.compare for baseline in read_baselines(path)],
        parse_tolerances(gates.tolerance),
        gates.allow_other,
    )
