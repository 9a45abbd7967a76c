"""The paper's own numbers (`paper.csv`, Tables 1 and 2), as separate tables or beside ours."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from evaluate.protocols.method_names import display_name
from evaluate.tables.comparison import ablation_table, subjects_table
from evaluate.tables.study import Study
from evaluate.tables.table import Column, Row, Table, missing_cell, number_cell, rank_across, rank_down

OURS = "Ours"
PAPER = Path(__file__).with_name("paper.csv")
SECTION = "paper (protocol not stated)"
UNSTATED = "The paper (Li et al. 2024) states neither background, SSIM variant, LPIPS network nor input range."
NOTE = f"The paper's rows are shown for orientation only; its subjects are not ours. {UNSTATED}"
METRICS = (("psnr", "PSNR ↑", True, 2), ("ssim", "SSIM ↑", True, 3), ("lpips", "LPIPS ↓", False, 3))


@dataclass(frozen=True)
class Published:
    """One method on one subject as printed in the paper."""

    table: int
    subject: str
    method: str
    numbers: dict[str, float]


def read_paper() -> list[Published]:
    """The rows of `paper.csv`."""
    with PAPER.open(encoding="utf-8", newline="") as stream:
        return [
            Published(
                int(row["table"]), row["subject"], row["method"], {name: float(row[name]) for name, *_ in METRICS}
            )
            for row in csv.DictReader(stream)
        ]


def paper_table_1() -> Table:
    """Table 1: five subjects, four methods, three metrics; marks are computed, not copied."""
    rows = [row for row in read_paper() if row.table == 1]
    methods = tuple(dict.fromkeys(row.method for row in rows))
    columns = [column for method in methods for column in _columns(method)]
    caption = "Quantitative comparison with state-of-the-art methods."
    return Table("paper-1", caption, "Metrics", tuple(columns), tuple(_rows(rows, methods, columns)), (UNSTATED,))


def paper_table_2() -> Table:
    """Table 2: the ablation study on ID 1."""
    published = [row for row in read_paper() if row.table == 2]
    rows = [
        Row(row.method, tuple(number_cell(row.numbers[n], d) for n, _, _, d in METRICS), rule=row.method == OURS)
        for row in published
    ]
    columns, caption = tuple(_columns("")), "Ablation study on ID 1."
    return rank_down(Table("paper-2", caption, "Methods", columns, tuple(rows), (UNSTATED,)))


def with_paper(study: Study) -> Table:
    """Our main table with the paper's rows in a section below; nothing is ranked across the two."""
    table = subjects_table(study)
    published = [row for row in read_paper() if row.table == 1]
    theirs = {our_name(row.method): row for row in published}
    methods = (
        *map(display_name, study.methods),
        *(name for name in theirs if name not in set(map(display_name, study.methods))),
    )
    width = len(study.metrics)
    titles = table.columns[:width]
    columns = [dataclasses.replace(column, group=method) for method in methods for column in titles]
    gap = tuple(missing_cell("not evaluated here") for _ in range((len(methods) - len(study.methods)) * width))
    own = [dataclasses.replace(row, cells=row.cells + gap, section="ours") for row in table.rows]
    places = [metric_family(name) for name in study.metrics]
    rows = own + _paper_rows(published, methods, places, columns)
    return dataclasses.replace(table, columns=tuple(columns), rows=tuple(rows), notes=(*table.notes, NOTE))


def ablation_with_paper(study: Study) -> Table:
    """Our ablation with the paper's Table 2 in a section below; nothing is ranked across the two."""
    table = ablation_table(study)
    families = [metric_family(name) for name in study.metrics]
    own = [dataclasses.replace(row, section=row.section or study.subjects[0]) for row in table.rows]
    theirs = []
    for row in paper_table_2().rows:
        cells = dict(zip((name for name, *_ in METRICS), row.cells, strict=True))
        shown = tuple(cells.get(name, missing_cell("not in the paper's table")) for name in families)
        theirs.append(Row(our_name(row.label), shown, f"ID 1, {SECTION}", row.rule))
    return dataclasses.replace(table, rows=(*own, *theirs), notes=(*table.notes, NOTE))


def _paper_rows(
    published: Sequence[Published], methods: Sequence[str], metrics: Sequence[str], columns: Sequence[Column]
) -> list[Row]:
    rows = []
    digits = {name: count for name, _, _, count in METRICS}
    for subject in dict.fromkeys(row.subject for row in published):
        by_method = {our_name(row.method): row.numbers for row in published if row.subject == subject}
        cells = []
        for method in methods:
            numbers = by_method.get(method, {})
            for metric in metrics:
                known = metric in numbers
                reason = "not in the paper's table"
                cells.append(number_cell(numbers[metric], digits[metric]) if known else missing_cell(reason))
        rows.append(rank_across(Row(subject, tuple(cells), SECTION), columns))
    return rows


def _rows(rows: Sequence[Published], methods: Sequence[str], columns: Sequence[Column]) -> list[Row]:
    found = []
    for subject in dict.fromkeys(row.subject for row in rows):
        numbers = {row.method: row.numbers for row in rows if row.subject == subject}
        cells = tuple(number_cell(numbers[method][n], d) for method in methods for n, _, _, d in METRICS)
        found.append(rank_across(Row(subject, cells), columns))
    return found


def _columns(group: str) -> list[Column]:
    return [Column(title, group, higher, digits) for _, title, higher, digits in METRICS]


def our_name(method: str) -> str:
    """The display name of a method of the paper."""
    return "GGAvatar" if method == OURS else method


def metric_family(metric: str) -> str:
    """The paper's column that corresponds to one of our metrics; otherwise the metric itself."""
    base = metric.partition("_")[0]
    return base if base in ("ssim", "lpips") else metric
