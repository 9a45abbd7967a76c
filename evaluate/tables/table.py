"""Table values: cells with unrounded numbers, marks and reasons, independent of any output format.

Not a pandas DataFrame with a Styler: a cell carries a reason and a source beside its number, the formats print section
rows, group rules and notes that Styler has no notion of, and importing pandas takes 0.5 s, its Styler 0.1 s more.
"""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas

Value = float | None

BEST, SECOND = "best", "second"
DASH = "–"
IDENTICAL = "identical"


@dataclass(frozen=True)
class CellSource:
    """What a number was computed from, so that it can be recomputed (`examples/recompute_table.py`).

    Attributes:
        statistic: `mean`, `median`, `worst_5_percent`, `std_over_frames`, `count`, `std_over_seeds`, `difference`
            (first method minus second) or `efficiency`.
        subjects: The value is the mean over these subjects of their mean over runs.
        methods: One method, or two for a difference.
        metric: Name of the metric or cost.
        seed: Seed of the only run that counts; None for all runs.
    """

    statistic: str
    subjects: tuple[str, ...]
    methods: tuple[str, ...]
    metric: str
    seed: int | None = None


@dataclass(frozen=True)
class Cell:
    """One table cell.

    Attributes:
        text: Printed text, without the mark.
        value: The unrounded number behind the text, if any.
        deviation: Sample deviation over seeds, printed after `±`.
        mark: `best`, `second` or empty.
        reason: Why there is no number, or details of it.
        source: What the number was computed from; None for numbers of the paper.
        setup: How the runs behind the number were trained, in words.
    """

    text: str
    value: Value = None
    deviation: Value = None
    mark: str = ""
    reason: str = ""
    source: CellSource | None = None
    setup: str = ""

    def with_texts(self, change: Callable[[str], str]) -> Cell:
        """The cell with its text, reason and setup changed."""
        return replace(self, text=change(self.text), reason=change(self.reason), setup=change(self.setup))


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        title: Heading, with its arrow.
        group: Common heading of adjacent columns, such as the method.
        higher_is_better: Direction of the ranking; None for columns that are not ranked.
        digits: Number of decimals.
    """

    title: str
    group: str = ""
    higher_is_better: bool | None = None
    digits: int = 3


@dataclass(frozen=True)
class Row:
    """One row; a `section` that differs from the previous row's is printed as a heading, `rule` draws a line above."""

    label: str
    cells: tuple[Cell, ...]
    section: str = ""
    rule: bool = False


@dataclass(frozen=True)
class Table:
    """A table with caption, headings and notes.

    Attributes:
        name: Key in files: `comparison`, `ablation`, `detail`, …
        caption: Text above the table.
        corner: Heading of the row labels.
        columns: Columns from left to right.
        rows: Rows from top to bottom.
        notes: Sentences below the table.
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
                raise ValueError(f"expected {len(self.columns)} cells in row {row.label!r}, found {len(row.cells)}")

    def __repr__(self) -> str:
        """Name and size."""
        return f"Table({self.name!r}, {len(self.rows)} rows × {len(self.columns)} columns)"

    def to_dataframe(self) -> pandas.DataFrame:
        """The unrounded numbers, NaN where there are none: rows by section and label, columns by group and title."""
        import pandas  # takes half a second, which the commands do without

        rows = pandas.MultiIndex.from_tuples([(row.section, row.label) for row in self.rows], names=["", self.corner])
        columns = pandas.MultiIndex.from_tuples([(column.group, column.title) for column in self.columns])
        return pandas.DataFrame([[cell.value for cell in row.cells] for row in self.rows], rows, columns, dtype=float)

    def _repr_html_(self) -> str:
        """What notebooks show: the printed texts."""
        import pandas

        texts = [[cell.text for cell in row.cells] for row in self.rows]
        rows = [f"{row.section} {row.label}".strip() for row in self.rows]
        columns = [f"{column.group} {column.title}".strip() for column in self.columns]
        return f"<p>{html.escape(self.caption)}</p>{pandas.DataFrame(texts, rows, columns).to_html()}"

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Group headings with the number of columns they span; empty if no column has a group."""
        spans: list[tuple[str, int]] = []
        for column in self.columns:
            if spans and spans[-1][0] == column.group:
                spans[-1] = (column.group, spans[-1][1] + 1)
            else:
                spans.append((column.group, 1))
        return spans if any(column.group for column in self.columns) else []

    def with_texts(self, change: Callable[[str], str]) -> Table:
        """The table with every printed text changed, for example escaped for an output format."""
        columns = (replace(column, title=change(column.title), group=change(column.group)) for column in self.columns)
        rows = (
            replace(
                row,
                label=change(row.label),
                cells=tuple(cell.with_texts(change) for cell in row.cells),
                section=change(row.section),
            )
            for row in self.rows
        )
        return replace(
            self,
            caption=change(self.caption),
            corner=change(self.corner),
            columns=tuple(columns),
            rows=tuple(rows),
            notes=tuple(map(change, self.notes)),
            group_corner=change(self.group_corner),
            protocol=change(self.protocol),
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return dataclasses.asdict(self)


def number_cell(value: float, digits: int, source: CellSource | None = None, deviation: Value = None) -> Cell:
    """A number with its decimals, followed by `±` and the deviation over seeds if there is one."""
    text = f"{value:.{digits}f}"
    return Cell(text if deviation is None else f"{text} ± {deviation:.{digits}f}", value, deviation, source=source)


def missing_cell(reason: str) -> Cell:
    """A dash with the reason for it."""
    return Cell(DASH, reason=reason)


def rank_marks(cells: Sequence[Cell], higher_is_better: bool, digits: int) -> list[str]:
    """Marks of competing cells: best and second by rounded value, so that equal prints are marked equally.

    Identical images (infinite PSNR) beat every number. With fewer than two competitors nothing is marked.
    """
    keys = [_rank_key(cell, higher_is_better, digits) for cell in cells]
    levels = sorted({key for key in keys if key is not None}, reverse=True)
    if sum(key is not None for key in keys) < 2:
        return ["" for _ in keys]
    names = {level: name for level, name in zip(levels, (BEST, SECOND), strict=False)}
    return [names.get(key, "") if key is not None else "" for key in keys]


def _rank_key(cell: Cell, higher_is_better: bool, digits: int) -> Value:
    """A number that increases with quality, rounded as printed."""
    if cell.text == IDENTICAL:
        return float("inf")
    if cell.value is None:
        return None
    rounded = float(f"{cell.value:.{digits}f}")
    return rounded if higher_is_better else -rounded


def with_marks(cells: Sequence[Cell], column: Column) -> list[Cell]:
    """Competing cells with their marks; unchanged if the column is not ranked."""
    if column.higher_is_better is None:
        return list(cells)
    names = rank_marks(cells, column.higher_is_better, column.digits)
    return [dataclasses.replace(cell, mark=name) for cell, name in zip(cells, names, strict=True)]


def rank_down(table: Table) -> Table:
    """Mark the best rows of every column within each section, as in the paper's Table 2."""
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
    """Mark the best groups of one row for every title, as in the paper's Table 1."""
    cells = list(row.cells)
    for title in dict.fromkeys(column.title for column in columns):
        places = [k for k, column in enumerate(columns) if column.title == title]
        for place, cell in zip(places, with_marks([cells[k] for k in places], columns[places[0]]), strict=True):
            cells[place] = cell
    return dataclasses.replace(row, cells=tuple(cells))
