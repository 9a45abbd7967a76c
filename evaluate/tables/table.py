"""A table as a value: cells with their unrounded numbers, ranks and reasons; building and drawing are other files."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Value = float | None

BEST, SECOND = "best", "second"
DASH = "–"
IDENTICAL = "identical"


@dataclass(frozen=True)
class CellSource:
    """What a number was computed from, so that anyone can compute it again (`examples/recompute_table.py`).

    Attributes:
        statistic: `mean`, `median`, `worst_5_percent`, `std_over_frames`, `count`, `std_over_seeds`, `difference`
            (first method minus second) or `efficiency`.
        subjects: The value is the mean over these of each subject's mean over its runs.
        methods: One, or two for a difference.
        metric: Name of the metric or of the cost.
        seed: Of the only run that counts; None for all runs.
    """

    statistic: str
    subjects: tuple[str, ...]
    methods: tuple[str, ...]
    metric: str
    seed: int | None = None


@dataclass(frozen=True)
class Cell:
    """One entry.

    Attributes:
        text: As printed, without mark.
        value: The unrounded number behind the text, if there is one.
        deviation: Sample deviation over seeds behind a `±`.
        mark: `best`, `second` or nothing.
        reason: Why there is no number.
        source: Where the number comes from; None for numbers of the paper.
    """

    text: str
    value: Value = None
    deviation: Value = None
    mark: str = ""
    reason: str = ""
    source: CellSource | None = None


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        title: Heading, with its arrow.
        group: Heading over neighbouring columns of the same group, such as the method.
        higher_is_better: Which end is shaded; None for columns that are not ranked.
        digits: Decimals.
    """

    title: str
    group: str = ""
    higher_is_better: bool | None = None
    digits: int = 3


@dataclass(frozen=True)
class Row:
    """One row; `section` is a heading printed above it where it differs from the row before, `rule` a line above it."""

    label: str
    cells: tuple[Cell, ...]
    section: str = ""
    rule: bool = False


@dataclass(frozen=True)
class Table:
    """Rows and columns with all that is printed around them.

    Attributes:
        name: Key in files: `comparison`, `ablation`, `detail`, …
        caption: Sentence above.
        corner: Heading of the row labels.
        columns: From left to right.
        rows: From top to bottom.
        notes: Sentences below.
        group_corner: Heading of the row labels in the line of the groups.
        protocol: Id of the protocol; empty for the paper's tables.
    """

    name: str
    caption: str
    corner: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    group_corner: str = "Methods"
    protocol: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row.cells) != len(self.columns):
                raise ValueError(f"expected {len(self.columns)} cells in row {row.label!r}, got {len(row.cells)}")

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Group headings with the number of columns each spans; empty if no column has a group."""
        spans: list[tuple[str, int]] = []
        for column in self.columns:
            if spans and spans[-1][0] == column.group:
                spans[-1] = (column.group, spans[-1][1] + 1)
            else:
                spans.append((column.group, 1))
        return spans if any(column.group for column in self.columns) else []

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return dataclasses.asdict(self)


def number_cell(value: float, digits: int, source: CellSource | None = None, deviation: Value = None) -> Cell:
    """A number with its decimals, and the deviation over seeds behind `±`."""
    text = f"{value:.{digits}f}"
    return Cell(text if deviation is None else f"{text} ± {deviation:.{digits}f}", value, deviation, source=source)


def missing_cell(reason: str) -> Cell:
    """A dash with the reason."""
    return Cell(DASH, reason=reason)


def rank_marks(cells: Sequence[Cell], higher_is_better: bool, digits: int) -> list[str]:
    """Marks of competing cells: best and second by the rounded numbers, so that what prints alike is marked alike.

    Identical images (infinite PSNR) beat every number. With fewer than two competitors nothing is marked.
    """
    keys = [_key(cell, higher_is_better, digits) for cell in cells]
    levels = sorted({key for key in keys if key is not None}, reverse=True)
    if sum(key is not None for key in keys) < 2:
        return ["" for _ in keys]
    names = {level: name for level, name in zip(levels, (BEST, SECOND), strict=False)}
    return [names.get(key, "") if key is not None else "" for key in keys]


def _key(cell: Cell, higher_is_better: bool, digits: int) -> Value:
    """A number that grows with quality, rounded as printed."""
    if cell.text == IDENTICAL:
        return float("inf")
    if cell.value is None:
        return None
    rounded = float(f"{cell.value:.{digits}f}")
    return rounded if higher_is_better else -rounded


def with_marks(cells: Sequence[Cell], column: Column) -> list[Cell]:
    """Competing cells of equal columns with their marks; unchanged if the column is not ranked."""
    if column.higher_is_better is None:
        return list(cells)
    names = rank_marks(cells, column.higher_is_better, column.digits)
    return [dataclasses.replace(cell, mark=name) for cell, name in zip(cells, names, strict=True)]


def rank_down(table: Table) -> Table:
    """Rank down the columns within each section, as in the paper's Table 2."""
    columns = list(zip(*(row.cells for row in table.rows), strict=True))
    sections = [row.section for row in table.rows]
    grid = []
    for column, cells in zip(table.columns, columns, strict=True):
        ranked = list(cells)
        for section in dict.fromkeys(sections):
            places = [k for k, name in enumerate(sections) if name == section]
            for place, cell in zip(places, with_marks([cells[k] for k in places], column), strict=True):
                ranked[place] = cell
        grid.append(ranked)
    rows = [
        dataclasses.replace(row, cells=tuple(cells))
        for row, cells in zip(table.rows, zip(*grid, strict=True), strict=True)
    ]
    return dataclasses.replace(table, rows=tuple(rows))


def rank_across(row: Row, columns: Sequence[Column]) -> Row:
    """Rank the groups of one row against each other, title by title, as in the paper's Table 1."""
    cells = list(row.cells)
    for title in dict.fromkeys(column.title for column in columns):
        places = [k for k, column in enumerate(columns) if column.title == title]
        for place, cell in zip(places, with_marks([cells[k] for k in places], columns[places[0]]), strict=True):
            cells[place] = cell
    return dataclasses.replace(row, cells=tuple(cells))
