"""The gates of a command: validated before any work starts, applied to the results at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluate.gates.checks import Check, check_limits, compare_with_baselines, parse_limits
from evaluate.options import Gates
from evaluate.protocols.results import Evaluation, read_results
from ggavatar.errors import InputError


@dataclass(frozen=True)
class Limits:
    """Limits that results must satisfy.

    Attributes:
        floors: Smallest allowed means by metric.
        ceilings: Largest allowed means by metric.
        baselines: Earlier results that the new ones must not be worse than.
        tolerances: How much worse a mean may be, by metric.
    """

    floors: Mapping[str, float]
    ceilings: Mapping[str, float]
    baselines: Sequence[Evaluation]
    tolerances: Mapping[str, float]

    def checks(self, evaluations: Sequence[Evaluation]) -> list[Check]:
        """The outcome of every comparison."""
        checks = check_limits(evaluations, self.floors, self.ceilings)
        return checks + compare_with_baselines(evaluations, self.baselines, self.tolerances)


def read_limits(gates: Gates) -> Limits:
    """Read the limits from the options.

    Raises:
        InputError: A limit or a baseline cannot be read, or a report is requested without a gate.
    """
    if gates.tolerance and not gates.compare:
        raise InputError("--tolerance: expected --compare FILE as well, found none; pass the earlier metrics.json")
    if (gates.junit or gates.github) and not (gates.fail_below or gates.fail_above or gates.compare):
        raise InputError("--junit, --github: expected --fail-below, --fail-above or --compare to report, found none")
    return Limits(
        parse_limits(gates.fail_below, "--fail-below"),
        parse_limits(gates.fail_above, "--fail-above"),
        [read_results(path) for path in gates.compare],
        parse_limits(gates.tolerance, "--tolerance"),
    )
