"""Secondary tables: spread over frames and seeds, paired differences, and costs."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from itertools import combinations

from evaluate.metrics.catalogue import metric_of, title_of
from evaluate.protocols.method_names import display_name
from evaluate.protocols.results import Evaluation
from evaluate.protocols.statistics import BLOCK_SPAN, RESAMPLES, deviation_over_seeds, paired_bootstrap
from evaluate.tables.comparison import missing_notes
from evaluate.tables.setups import mixing_notes
from evaluate.tables.study import Study, with_setup
from evaluate.tables.table import Cell, CellSource, Column, Row, Table, missing_cell, number_cell

SUMMARY_COLUMNS = (
    ("mean", "mean"),
    ("median", "median"),
    ("worst_5_percent", "worst 5 %"),
    ("std_over_frames", "σ frames"),
)


def detail_table(study: Study) -> Table:
    """All measured metrics: one row per run and metric, with mean, median, worst 5 % and deviations."""
    columns = [Column("frames", digits=0), *(Column(title) for _, title in SUMMARY_COLUMNS), Column("σ seeds")]
    rows: list[Row] = []
    for subject in study.subjects:
        for method in study.methods:
            runs = study.runs(subject, method)
            for metric in runs[0].columns if runs else ():
                rows += _detail_rows(runs, metric, f"{subject} · {display_name(method)}")
    caption = f"All metrics under {study.protocol.id}."
    notes = (
        *mixing_notes(study),
        "worst 5 % is the mean over the worst twentieth of the frames, at least one.",
        "σ frames is the sample deviation between frames of one run; σ seeds is that between runs with other seeds.",
        *missing_notes(study, study.evaluations[0].columns),
    )
    return Table("detail", caption, "Metric", tuple(columns), tuple(rows), notes, protocol=study.protocol.id)


def _detail_rows(runs: Sequence[Evaluation], metric: str, section: str) -> Iterator[Row]:
    """One row per run; the deviation over seeds is in the first."""
    means = [m for run in runs if (m := run.summary(metric).mean) is not None]
    over_seeds = deviation_over_seeds(means) if len(means) == len(runs) else None
    for place, run in enumerate(runs):
        label = title_of(metric) + (f", seed {run.seed}" if len(runs) > 1 else "")
        found, digits = run.summary(metric), metric_of(metric).digits
        reason = run.missing.get(metric, "all predictions equal the ground truth" if found.identical else "not defined")
        where = ((run.subject,), (run.method,), metric)
        cells = [number_cell(float(found.count), 0, CellSource("count", *where, run.seed))]
        cells += [
            _number(getattr(found, name), digits, reason, CellSource(name, *where, run.seed))
            for name, _ in SUMMARY_COLUMNS
        ]
        deviation = over_seeds if place == 0 else None
        cells.append(_number(deviation, digits, "needs runs with several seeds", CellSource("std_over_seeds", *where)))
        yield Row(label, tuple(with_setup(cell, [run]) for cell in cells), section)


def _number(value: float | None, digits: int, reason: str, source: CellSource) -> Cell:
    return missing_cell(reason) if value is None else number_cell(value, digits, source)


def significance_table(study: Study) -> Table | None:
    """Paired differences of every two methods with block-bootstrap intervals; None for a single method."""
    if len(study.methods) < 2:
        return None
    columns = tuple(Column(title_of(name), digits=metric_of(name).digits) for name in study.metrics)
    rows = []
    for first, second in combinations(study.methods, 2):
        cells = tuple(_difference_cell(study, first, second, name) for name in study.metrics)
        rows.append(Row(f"{display_name(first)} − {display_name(second)}", cells))
    notes = (
        *mixing_notes(study),
        "Mean of paired per-frame differences, first minus second, and its 95 % interval; * marks intervals without 0.",
        f"Circular block bootstrap, {RESAMPLES} samples, blocks of {BLOCK_SPAN} source frames (at most a quarter of "
        "the test frames), stratified by subject; runs of several seeds are averaged per frame first.",
    )
    caption = f"Paired differences under {study.protocol.id}."
    return Table("significance", caption, "Difference", columns, tuple(rows), notes, protocol=study.protocol.id)


def paired_differences(study: Study, first: str, second: str, metric: str) -> dict[str, tuple[list[int], list[float]]]:
    """By subject, the frames in which both methods have a finite value and the differences there."""
    groups = {}
    for subject in study.subjects:
        one, other = (_frame_means(study.runs(subject, method), metric) for method in (first, second))
        common = sorted(set(one) & set(other))
        if common:
            groups[subject] = (common, [one[n] - other[n] for n in common])
    return groups


def _frame_means(runs: Sequence[Evaluation], metric: str) -> dict[int, float]:
    """Mean over seeds for every frame with a finite value in all runs."""
    columns = [dict(zip(run.frames, run.values.get(metric, ()), strict=False)) for run in runs]
    if not columns:
        return {}
    common = set.intersection(*(set(column) for column in columns))
    rows = {n: [column[n] for column in columns] for n in common}
    return {
        n: statistics.fmean(v for v in row if v is not None)
        for n, row in rows.items()
        if all(v is not None and math.isfinite(v) for v in row)
    }


def _difference_cell(study: Study, first: str, second: str, metric: str) -> Cell:
    groups = paired_differences(study, first, second, metric)
    found = paired_bootstrap(list(groups.values()))
    if found is None:
        return missing_cell("no frame has this metric for both")
    digits = metric_of(metric).digits
    star = "*" if found.is_significant else ""
    text = f"{found.mean:+.{digits}f} [{found.low:+.{digits}f}, {found.high:+.{digits}f}]{star}"
    reason = f"{found.frames} frame pairs, blocks of {found.block}"
    return Cell(
        text, found.mean, reason=reason, source=CellSource("difference", tuple(groups), (first, second), metric)
    )


COSTS = (
    ("fps", "FPS", 1),
    ("gaussians", "Gaussians", 0),
    ("model_megabytes", "MB", 1),
    ("training_seconds", "training, s", 0),
    ("peak_memory_megabytes", "peak MB", 0),
)


def efficiency_table(study: Study) -> Table | None:
    """Costs of rendering and training; None if no evaluation recorded them."""
    known = [e for e in study.evaluations if e.efficiency]
    if not known:
        return None
    columns = tuple(Column(title, digits=digits) for _, title, digits in COSTS)
    several = len({(e.subject, e.method) for e in known}) < len(known)
    rows = tuple(
        Row(f"{e.subject} · {display_name(e.method)}" + (f", seed {e.seed}" if several else ""), _costs(e))
        for e in known
    )
    words = sorted({e.efficiency["fps_statement"] for e in known if e.efficiency.get("fps_statement")})
    notes = (*mixing_notes(study), *words)
    caption = "What rendering and training cost."
    return Table("efficiency", caption, "Method", columns, rows, notes, protocol=study.protocol.id)


def _costs(run: Evaluation) -> tuple[Cell, ...]:
    found = {key: None if (value := run.efficiency.get(key)) is None else float(value) for key, _, _ in COSTS}
    where = (run.subject,), (run.method,)
    cells = (
        _number(found[key], digits, "not recorded", CellSource("efficiency", *where, key, run.seed))
        for key, _, digits in COSTS
    )
    return tuple(with_setup(cell, [run]) for cell in cells)
