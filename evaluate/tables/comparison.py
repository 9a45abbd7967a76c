"""The main tables: subjects × methods × metrics as in the paper's Table 1, or one row per method as in its Table 2."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from evaluate.metrics.catalogue import metric_of, title_of
from evaluate.protocols.method_names import display_name
from evaluate.protocols.protocol import Protocol
from evaluate.tables.setups import mixing_notes, setup_notes
from evaluate.tables.study import Study
from evaluate.tables.table import CellSource, Column, Row, Table, missing_cell, number_cell, rank_across, rank_down


def metric_columns(metrics: Sequence[str], group: str = "") -> list[Column]:
    """Ranked columns of metrics."""
    found = [metric_of(name) for name in metrics]
    return [
        Column(f"{title_of(name)} {m.arrow}", group, m.higher_is_better, m.digits)
        for name, m in zip(metrics, found, strict=True)
    ]


def subjects_table(study: Study) -> Table:
    """One row per subject, one group of columns per method, and the mean over subjects that all methods have."""
    columns = [column for method in study.methods for column in metric_columns(study.metrics, display_name(method))]
    rows = []
    for subject in study.subjects:
        cells = [study.cell(subject, method, metric) for method in study.methods for metric in study.metrics]
        rows.append(Row(subject, tuple(cells)))
    if len(rows) > 1:
        rows.append(_mean_row(study, rows, columns))
    marked = tuple(rank_across(row, columns) for row in rows)
    return Table(
        "comparison", caption(study), "Metrics", tuple(columns), marked, notes(study), protocol=study.protocol.id
    )


def _mean_row(study: Study, rows: Sequence[Row], columns: Sequence[Column]) -> Row:
    """Mean over the rows in which every method has a value."""
    cells, counts = [], set()
    for place, column in enumerate(columns):
        competing = [k for k, other in enumerate(columns) if other.title == column.title]
        complete = [row for row in rows if all(row.cells[k].value is not None for k in competing)]
        counts.add(len(complete))
        values = [v for row in complete if (v := row.cells[place].value) is not None]
        if not values:
            cells.append(missing_cell("no subject has this metric for every method"))
            continue
        method, metric = study.methods[place // len(study.metrics)], study.metrics[place % len(study.metrics)]
        source = CellSource("mean", tuple(row.label for row in complete), (method,), metric)
        cells.append(number_cell(statistics.fmean(values), column.digits, source))
    size = f"{min(counts)}–{max(counts)}" if len(counts) > 1 else str(counts.pop())
    return Row(f"mean of {size}", tuple(cells), rule=True)


def ablation_table(study: Study) -> Table:
    """One row per method or variant, one section per subject; the full method comes last, below a rule."""
    columns = tuple(metric_columns(study.metrics))
    full = min(study.methods, key=len)
    order = [*(method for method in study.methods if method != full), full]
    several = len(study.subjects) > 1
    rows = [
        Row(
            display_name(method),
            tuple(study.cell(subject, method, metric) for metric in study.metrics),
            section=subject if several else "",
            rule=method == full,
        )
        for subject in study.subjects
        for method in order
        if study.runs(subject, method)
    ]
    where = "" if several else f" on {study.subjects[0]}"
    words = f"Ablation study{where}. {caption(study)}"
    table = Table("ablation", words, "Methods", columns, tuple(rows), notes(study), protocol=study.protocol.id)
    return rank_down(table)


def caption(study: Study) -> str:
    """Protocol and number of test frames, as a sentence."""
    return f"Protocol {study.protocol.id} (digest {study.protocol.digest[:12]}), {_frames(study)}."


def _frames(study: Study) -> str:
    counts = sorted({len(e.frames) for e in study.evaluations})
    return f"{counts[0]} test frames" if len(counts) == 1 else f"{counts[0]}–{counts[-1]} test frames"


def notes(study: Study) -> tuple[str, ...]:
    """Notes on the cells: conditions, ranking, seeds, missing values."""
    found = [*mixing_notes(study), conditions(study.protocol), *setup_notes(study)]
    found.append("Cells are means over test frames; best and second are marked per metric, ties after rounding shared.")
    if any(len(study.runs(s, m)) > 1 for s in study.subjects for m in study.methods):
        found.append("± is the sample deviation over seeds, not over frames.")
    found += missing_notes(study, study.metrics)
    found += _identical_notes(study)
    for subject in study.subjects:
        runs = [e for e in study.evaluations if e.subject == subject]
        if len({e.hashes.get("ground_truth") for e in runs}) > 1:
            found.append(
                f"{subject}: the methods were scored against different ground truths or frames; do not rank them."
            )
    found += [f"{e.subject}, {display_name(e.method)}: {note}" for e in study.evaluations for note in e.notes]
    return tuple(dict.fromkeys(found))


def conditions(protocol: Protocol) -> str:
    """The conditions of measurement and the metric definitions."""
    parts = [f"test frames {protocol.split}", f"background {protocol.background}", f"masks {protocol.mask}"]
    parts += [
        f"region {protocol.region}",
        f"size {protocol.resolution}",
        "8-bit images, nothing fitted to test frames",
    ]
    exact = [f"{title_of(name)}: {metric_of(name).definition}" for name in protocol.table_metrics]
    return f"{protocol.id}: {', '.join(parts)}. {'; '.join(exact)}."


def missing_notes(study: Study, metrics: Sequence[str]) -> list[str]:
    """Reasons for the dashes in a table of metrics, each once."""
    found = [f"– {title_of(m)}: {e.missing[m]}." for e in study.evaluations for m in metrics if m in e.missing]
    return list(dict.fromkeys(found))


def _identical_notes(study: Study) -> list[str]:
    """Notes on evaluations in which some but not all frames have an infinite PSNR."""
    found = []
    for e in study.evaluations:
        count = sum(value is not None and math.isinf(value) for value in e.values.get("psnr", ()))
        if 0 < count < len(e.frames):
            found.append(
                f"{e.subject}, {display_name(e.method)}: {count} identical frames are not part of the mean PSNR."
            )
    return found
