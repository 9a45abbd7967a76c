"""Tables as data: CSV with one line per cell, and strict JSON. Numbers are not rounded.

The csv module rather than DataFrame.to_csv: importing pandas takes 0.5 s, more than the command's whole start-up.
"""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.escaping.csv_cells import csv_text
from evaluate.tables.table import Cell, Column, Row, Table
from ggavatar.io.json_files import readable_json

KEYS = ("table", "section", "row", "group", "column")
FIELDS = (*KEYS, "value", "deviation_over_seeds", "text", "mark", "reason", "protocol", "setup")


def to_csv(tables: Sequence[Table]) -> str:
    """CSV with one line per cell."""
    lines = (
        (*_keys(table, row, column), cell.value, cell.deviation, *_words(cell), table.protocol, cell.setup)
        for table in tables
        for row in table.rows
        for column, cell in zip(table.columns, row.cells, strict=True)
    )
    return csv_text([FIELDS, *lines])


def _keys(table: Table, row: Row, column: Column) -> tuple[str, ...]:
    return table.name, row.section, row.label, column.group, column.title


def _words(cell: Cell) -> tuple[str, ...]:
    return cell.text, cell.mark, cell.reason


def to_json(tables: Sequence[Table], results: Sequence[str] = ()) -> str:
    """JSON of all tables with captions and notes, and the paths of the results they were made from.

    Args:
        tables: Tables to write.
        results: Paths of result files, relative to the folder of the tables.
    """
    content = {
        "schema": "ggavatar-tables",
        "version": 1,
        "results": list(results),
        "tables": [table.as_dict() for table in tables],
    }
    return readable_json(content, indent=1) + "\n"
