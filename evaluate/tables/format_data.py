"""Tables as data: CSV with one line per cell, and strict JSON. Numbers are not rounded.

The csv module rather than DataFrame.to_csv: importing pandas takes 0.5 s, more than the command's whole start-up.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence

from evaluate.tables.table import Table

KEYS = ("table", "section", "row", "group", "column")
FIELDS = (*KEYS, "value", "deviation_over_seeds", "text", "mark", "reason", "protocol", "setup")


def to_csv(tables: Sequence[Table]) -> str:
    """CSV with one line per cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(FIELDS)
    for table in tables:
        for row in table.rows:
            for column, cell in zip(table.columns, row.cells, strict=True):
                numbers = ["" if value is None else repr(value) for value in (cell.value, cell.deviation)]
                keys = [table.name, row.section, row.label, column.group, column.title]
                writer.writerow([*keys, *numbers, cell.text, cell.mark, cell.reason, table.protocol, cell.setup])
    return stream.getvalue()


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
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
