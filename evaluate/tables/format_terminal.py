"""Tables for a terminal, by rich: best in bold red, second in yellow; as signs where colors are not supported."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from evaluate.tables.table import BEST, SECOND, Cell, Column, Table
from ggavatar.text.terminal import printable

STYLES = {BEST: "bold red", SECOND: "yellow"}
SIGNS = {BEST: "*", SECOND: "'"}
PADDING, EDGES = 3, 2
"""Characters between two columns, and at both ends of a line together."""


def show(table: Table, console: Console) -> None:
    """Print a table with its notes; one wider than the console is split into several parts, never truncated."""
    table = table.with_texts(printable)
    colors = console.color_system is not None and not console.no_color
    console.print(Text(table.caption, style="bold"))
    for indices in column_chunks(table, console.width):
        console.print(_rich_table(table, indices, colors))
    if not colors and any(cell.mark for row in table.rows for cell in row.cells):
        console.print("* best  ' second", highlight=False)
    for note in table.notes:
        console.print(Text(note, style="dim"))
    console.print()


def column_chunks(table: Table, width: int) -> list[list[int]]:
    """Column indices by part: as many as fit the width; groups stay together if they fit at all."""
    labels = [table.corner, *(row.label for row in table.rows), *(row.section for row in table.rows)]
    available_width = width - max(map(cell_len, labels)) - EDGES
    chunks: list[list[int]] = []
    for group in _groups(table, available_width):
        needed = sum(_width(table, index) for index in [*(chunks[-1] if chunks else ()), *group])
        if chunks and needed <= available_width:
            chunks[-1] += group
        else:
            chunks.append(list(group))
    return chunks


def _groups(table: Table, available_width: int) -> list[list[int]]:
    """Columns that stay together: those of one group, or single columns if the group is too wide."""
    groups: dict[str, list[int]] = {}
    for index, column in enumerate(table.columns):
        groups.setdefault(column.group or str(index), []).append(index)
    fitting = {
        name: sum(_width(table, index) for index in indices) <= available_width for name, indices in groups.items()
    }
    return [
        part
        for name, indices in groups.items()
        for part in ([indices] if fitting[name] else [[index] for index in indices])
    ]


def _width(table: Table, index: int) -> int:
    """Width of a column in characters, including a sign."""
    column = table.columns[index]
    texts = (column.title, column.group, *(f"{row.cells[index].text}*" for row in table.rows))
    return max(map(cell_len, texts)) + PADDING


def _rich_table(table: Table, indices: Sequence[int], colors: bool) -> RichTable:
    rich_table = RichTable(box=box.SIMPLE_HEAD, pad_edge=False)
    rich_table.add_column(Text(table.corner), no_wrap=True)
    for index in indices:
        rich_table.add_column(_heading(table.columns[index]), justify="right", no_wrap=True)
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            rich_table.add_section()
            rich_table.add_row(Text(row.section, style="italic"))
            section = row.section
        if row.rule:
            rich_table.add_section()
        rich_table.add_row(Text(row.label), *(_cell(row.cells[index], colors) for index in indices))
    return rich_table


def _heading(column: Column) -> Text:
    return Text(f"{column.group}\n{column.title}" if column.group else column.title)


def _cell(cell: Cell, colors: bool) -> Text:
    if cell.mark and not colors:
        return Text(cell.text + SIGNS[cell.mark])
    return Text(cell.text, style=STYLES.get(cell.mark, ""))
