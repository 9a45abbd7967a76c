"""The gates of a command: read and checked before anything takes time, applied when there are results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluate.gates.checks import Check, check_limits, compare_with_baselines, parse_limits
from evaluate.options import Gates
from evaluate.protocols.results import Evaluation, read_results
from ggavatar.errors import InputError


@dataclass(frozen=True)
class Limits:
    """What results must hold.

    Attributes:
        floors: Least means by metric.
        ceilings: Greatest means by metric.
        baselines: Earlier results that must not be undercut.
        tolerances: By how much a mean may undercut them, by metric.
    """

    floors: Mapping[str, float]
    ceilings: Mapping[str, float]
    baselines: Sequence[Evaluation]
    tolerances: Mapping[str, float]

    def checks(self, evaluations: Sequence[Evaluation]) -> list[Check]:
        """Every comparison and how it went."""
        checks = check_limits(evaluations, self.floors, self.ceilings)
        return checks + compare_with_baselines(evaluations, self.baselines, self.tolerances)


def read_limits(gates: Gates) -> Limits:
    """The limits that the options name.

    Raises:
        InputError: One cannot be read, there is no such earlier result, or there is a report asked for and no gate.
    """
    if gates.tolerance and not gates.compare:
        raise InputError("--tolerance: expected --compare FILE beside it, found none; name the earlier metrics.json")
    if (gates.junit or gates.github) and not (gates.fail_below or gates.fail_above or gates.compare):
        raise InputError("--junit, --github: expected --fail-below, --fail-above or --compare to report, found none")
    return Limits(
        parse_limits(gates.fail_below, "--fail-below"),
        parse_limits(gates.fail_above, "--fail-above"),
        [read_results(path) for path in gates.compare],
        parse_limits(gates.tolerance, "--tolerance"),
    )
