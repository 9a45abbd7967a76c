"""Studies: evaluations under one protocol, by subject and method."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace

from evaluate.metrics.catalogue import metric_of
from evaluate.protocols.method_names import display_name
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import Evaluation
from evaluate.protocols.statistics import deviation_over_seeds
from evaluate.tables.table import IDENTICAL, Cell, CellSource, missing_cell, number_cell
from ggavatar.errors import InputError


@dataclass(frozen=True)
class Study:
    """Evaluations under one protocol, by subject and method; several of one pair are runs with different seeds."""

    evaluations: tuple[Evaluation, ...]

    @property
    def subjects(self) -> tuple[str, ...]:
        """Subjects in the order of the evaluations."""
        return tuple(dict.fromkeys(e.subject for e in self.evaluations))

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods in the order of the evaluations."""
        return tuple(dict.fromkeys(e.method for e in self.evaluations))

    @property
    def metrics(self) -> tuple[str, ...]:
        """Metrics of the main table."""
        return self.protocol.table_metrics

    @property
    def protocol(self) -> Protocol:
        """The common protocol."""
        return self.evaluations[0].protocol

    def runs(self, subject: str, method: str) -> list[Evaluation]:
        """The evaluations of one subject and method, one per seed."""
        return [e for e in self.evaluations if e.subject == subject and e.method == method]

    def cell(self, subject: str, method: str, metric: str) -> Cell:
        """Mean over frames, then over seeds; `±` is the deviation over seeds."""
        runs = self.runs(subject, method)
        if not runs:
            return missing_cell(f"{display_name(method)} was not evaluated on {subject}")
        return with_setup(self._cell_of(runs, metric), runs)

    def _cell_of(self, runs: Sequence[Evaluation], metric: str) -> Cell:
        """A cell of at least one run."""
        subject, method = runs[0].subject, runs[0].method
        summaries = [run.summary(metric) for run in runs]
        means = [summary.mean for summary in summaries if summary.mean is not None]
        if len(means) == len(runs):
            source = CellSource("mean", (subject,), (method,), metric)
            return number_cell(statistics.fmean(means), metric_of(metric).digits, source, deviation_over_seeds(means))
        if all(summary.identical for summary in summaries):
            return Cell(IDENTICAL, reason="all predictions equal the ground truth; PSNR is infinite")
        return missing_cell(next((r.missing[metric] for r in runs if metric in r.missing), "not measured"))


def with_setup(cell: Cell, runs: Sequence[Evaluation]) -> Cell:
    """The cell with the setups of the runs behind it, each once."""
    return replace(cell, setup="; ".join(dict.fromkeys(run.setup.describe() for run in runs)))


def studies(evaluations: Sequence[Evaluation]) -> list[Study]:
    """Group evaluations into studies of one protocol each.

    Raises:
        InputError: Two evaluations of one subject, method and protocol do not differ in their seed, or one is a run
            and the other not.
    """
    groups: dict[str, list[Evaluation]] = {}
    seen: set[tuple[object, ...]] = set()
    for evaluation in evaluations:
        key = (evaluation.protocol.digest, evaluation.subject, evaluation.method, evaluation.seed)
        if key in seen:
            raise InputError(
                f"two evaluations of {evaluation.method} on {evaluation.subject} with seed {evaluation.seed} under "
                f"{evaluation.protocol.id}; omit one, or distinguish them with --labels"
            )
        seen.add(key)
        groups.setdefault(evaluation.protocol.digest, []).append(evaluation)
    found = [Study(tuple(group)) for group in groups.values()]
    for study in found:
        for evaluation in study.evaluations:
            runs = study.runs(evaluation.subject, evaluation.method)
            if len({run.setup.origin for run in runs}) > 1:
                raise InputError(
                    f"{evaluation.method} on {evaluation.subject} names a run and pictures of another origin; give the "
                    "pictures another name with --label or --pred-as, or the runs others with --labels"
                )
            if evaluation.seed is None and len(runs) > 1:
                raise InputError(
                    f"several evaluations of {evaluation.method} on {evaluation.subject}, one of them without a seed; "
                    "score it again with --seed, or distinguish them with --labels"
                )
    return found
