"""Tables as data: CSV with one line a cell, and strict JSON. Numbers are not rounded."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence

from evaluate.tables.table import Table

WHERE = ("table", "section", "row", "group", "column")
FIELDS = (*WHERE, "value", "deviation_over_seeds", "text", "mark", "reason", "protocol")


def to_csv(tables: Sequence[Table]) -> str:
    """One line a cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(FIELDS)
    for table in tables:
        for row in table.rows:
            for column, cell in zip(table.columns, row.cells, strict=True):
                numbers = ["" if value is None else repr(value) for value in (cell.value, cell.deviation)]
                where = [table.name, row.section, row.label, column.group, column.title]
                writer.writerow([*where, *numbers, cell.text, cell.mark, cell.reason, table.protocol])
    return stream.getvalue()


def to_json(tables: Sequence[Table], results: Sequence[str] = ()) -> str:
    """All tables with their captions and notes, and where the results lie that they were made from.

    Args:
        tables: What to write.
        results: Paths of result files, relative to the table's folder.
    """
    content = {
        "schema": "ggavatar-tables",
        "version": 1,
        "results": list(results),
        "tables": [table.as_dict() for table in tables],
    }
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
