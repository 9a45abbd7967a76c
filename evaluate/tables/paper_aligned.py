"""The paper's numbers in the lines of our subjects: columns of their own, marked, and never ranked with ours."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

from evaluate.protocols.method_names import display_name
from evaluate.tables.comparison import ablation_table, subjects_table
from evaluate.tables.paper import METRICS, UNSTATED, Published, metric_family, our_name, read_paper
from evaluate.tables.study import Study
from evaluate.tables.table import Cell, Column, Row, Table, missing_cell, number_cell, rank_across, rank_down
from ggavatar.errors import InputError, nearest
from ggavatar.text.names import clean_name

MARK = "†"
REASON = "printed in the paper; its protocol is not stated"
DIGITS = {name: digits for name, _, _, digits in METRICS}


def parse_paper_subjects(texts: Sequence[str], subjects: Sequence[str]) -> dict[str, str]:
    """The paper's subject by ours, from texts such as `cap1=ID1,cap2=ID3`.

    Args:
        texts: Assignments, several in one text separated by commas.
        subjects: Our subjects.

    Raises:
        InputError: Not SUBJECT=ID, or one of the two is unknown.
    """
    known = list(dict.fromkeys(row.subject for row in read_paper()))
    found = {}
    for part in (part.strip() for text in texts for part in text.split(",")):
        ours, equals, theirs = part.rpartition("=")
        ours = clean_name(ours)
        number = re.fullmatch(r"(?:ID)?\s*(\d+)", theirs.strip(), re.IGNORECASE)
        name = f"ID {int(number[1])}" if number else theirs
        if not equals or name not in known:
            raise InputError(f"--paper-subjects: expected SUBJECT=ID with {', '.join(known)}, found {part!r}")
        if ours not in subjects:
            raise InputError(
                f"--paper-subjects: no subject {ours!r} in the table{nearest(ours, subjects)}; it has "
                f"{', '.join(subjects)}"
            )
        found[ours] = name
    return found


def subjects_table_aligned(study: Study, aligned: Mapping[str, str]) -> Table:
    """One row per subject: our methods, then the paper's on the subject that was named for it."""
    table = subjects_table(study)
    published = [row for row in read_paper() if row.table == 1]
    methods = list(dict.fromkeys(row.method for row in published))
    titles = table.columns[: len(study.metrics)]
    columns = [
        dataclasses.replace(column, group=f"{our_name(method)} {MARK}") for method in methods for column in titles
    ]
    rows = []
    for row in table.rows:
        theirs = aligned.get(row.label)
        cells = [_cell(published, theirs, method, metric) for method in methods for metric in study.metrics]
        ranked = rank_across(Row(row.label, tuple(cells)), columns)
        rows.append(dataclasses.replace(row, label=_label(row.label, aligned), cells=row.cells + ranked.cells))
    return _marked(table, columns, rows, aligned)


def ablation_table_aligned(study: Study, aligned: Mapping[str, str]) -> Table:
    """One row per method: our numbers, then the paper's for the same method on the subject that was named for ours."""
    table = ablation_table(study)
    columns = [dataclasses.replace(column, group=f"paper {MARK}") for column in table.columns]
    by_label = {display_name(method): method for method in study.methods}
    theirs = []
    for row in table.rows:
        subject = aligned.get(row.section or study.subjects[0])
        name = display_name(by_label[row.label])
        cells = tuple(_cell(read_paper(), subject, name, metric) for metric in study.metrics)
        theirs.append(dataclasses.replace(row, cells=cells))
    ranked = rank_down(dataclasses.replace(table, columns=tuple(columns), rows=tuple(theirs)))
    rows = [
        dataclasses.replace(row, section=_label(row.section, aligned), cells=row.cells + other.cells)
        for row, other in zip(table.rows, ranked.rows, strict=True)
    ]
    return _marked(table, columns, rows, aligned)


def _marked(table: Table, columns: Sequence[Column], rows: Sequence[Row], aligned: Mapping[str, str]) -> Table:
    """The table with the paper's columns and what they mean, in the caption and below."""
    pairs = ", ".join(f"{ours} = {theirs}" for ours, theirs in aligned.items())
    where = f"{MARK} printed in the paper, in the line of the subject named for it ({pairs})"
    note = f"{where}. {UNSTATED} Not ranked with ours."
    return dataclasses.replace(
        table,
        caption=f"{table.caption} {MARK} The paper's numbers; its protocol is not stated.",
        columns=table.columns + tuple(columns),
        rows=tuple(rows),
        notes=(note, *table.notes),
    )


def _label(subject: str, aligned: Mapping[str, str]) -> str:
    return f"{subject} ({aligned[subject]})" if subject in aligned else subject


def _cell(published: Sequence[Published], subject: str | None, method: str, metric: str) -> Cell:
    """The paper's number of a method, in its tables in order; a dash if it has none."""
    if subject is None:
        return missing_cell("no subject of the paper was named for this one")
    family = metric_family(metric)
    for row in published:
        if row.subject == subject and our_name(row.method) == our_name(method) and family in row.numbers:
            return dataclasses.replace(number_cell(row.numbers[family], DIGITS[family]), reason=REASON)
    return missing_cell("not in the paper's tables")
