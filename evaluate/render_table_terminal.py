"""Tables for a terminal, drawn by rich: best in bold red, second in yellow, plain where colours are not shown."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable
from rich.text import Text

from evaluate.table import BEST, SECOND, Cell, Table

STYLES = {BEST: "bold red", SECOND: "yellow"}
SIGNS = {BEST: "*", SECOND: "'"}


def show(table: Table, console: Console) -> None:
    """Print a table with its notes; marks are signs (* best, ' second) where the console has no colours."""
    drawn = RichTable(title=escape(table.caption), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    drawn.add_column(escape(table.corner))
    for column in table.columns:
        drawn.add_column(escape(f"{column.group}\n{column.title}" if column.group else column.title), justify="right")
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            drawn.add_section()
            drawn.add_row(Text(row.section, style="italic"))
            section = row.section
        if row.rule:
            drawn.add_section()
        drawn.add_row(Text(row.label), *(_cell(cell, console) for cell in row.cells))
    console.print(drawn)
    if not _has_colors(console) and any(cell.mark for row in table.rows for cell in row.cells):
        console.print("* best  ' second", highlight=False)
    for note in table.notes:
        console.print(Text(note, style="dim"))


def _cell(cell: Cell, console: Console) -> Text:
    if cell.mark and not _has_colors(console):
        return Text(cell.text + SIGNS[cell.mark])
    return Text(cell.text, style=STYLES.get(cell.mark, ""))


def _has_colors(console: Console) -> bool:
    return console.color_system is not None and not console.no_color
