"""Tables as GitHub Markdown: **best**, <u>second</u>, notes below.

DataFrame.to_markdown would need tabulate, another dependency, and would not escape cells.
"""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.escaping.markdown import markdown_text
from evaluate.tables.table import BEST, SECOND, Cell, Row, Table


def to_markdown(tables: Sequence[Table]) -> str:
    """Tables with their captions as one document."""
    return "\n".join(_table(table.with_texts(markdown_text)) for table in tables)


def _table(table: Table) -> str:
    titles = [f"{column.group} {column.title}".strip() for column in table.columns]
    lines = [f"**{table.caption}**", "", _line([table.corner, *titles])]
    lines.append(_line(["---", *("---:" for _ in table.columns)]))
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            lines.append(_line([f"*{row.section}*", *("" for _ in table.columns)]))
            section = row.section
        lines.append(_line([row.label, *_cells(row)]))
    lines += ["", *(f"- {note}" for note in table.notes), ""]
    return "\n".join(lines)


def _cells(row: Row) -> list[str]:
    return [_cell(cell) for cell in row.cells]


def _cell(cell: Cell) -> str:
    text = cell.text
    return {BEST: f"**{text}**", SECOND: f"<u>{text}</u>"}.get(cell.mark, text)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
