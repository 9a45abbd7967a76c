"""Reenactments as a table and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evaluate.protocols.method_names import display_name
from evaluate.reenactment.measure import Reenactment
from evaluate.tables.format_data import to_csv
from evaluate.tables.format_markdown import to_markdown
from evaluate.tables.table import Cell, Column, Row, Table
from ggavatar.io.atomic import write_text
from ggavatar.io.json_files import write_json

SCHEMA, VERSION = "ggavatar-reenactment", 1
FILES = "reenactment.json", "reenactment.md", "reenactment.csv"
COLUMNS = (
    Column("correlation ↑", digits=3),
    Column("slope → 1", digits=3),
    Column("AED ↓", digits=4),
    Column("APD (°) ↓", digits=2),
    Column("jitter ↓", digits=4),
    Column("driver's jitter", digits=4),
    Column("frames", digits=0),
    Column("lost", digits=0),
)
NOTES = (
    "Correlation and slope of the avatar's 51 expression scores over the driver's, weighted by the deviation of the "
    "driver's (docs/evaluation.md); rows marked 'itself' are driven by their own test frames, without a transfer.",
)


def reenactment_table(found: Sequence[Reenactment]) -> Table:
    """One row for each avatar and driver, and the mean over other people's performances."""
    rows = [Row(_label(one), _cells(_values(one))) for one in found]
    others = [_values(one) for one in found if not one.is_own]
    if len(others) > 1:
        means = [_mean([values[column] for values in others]) for column in range(len(COLUMNS))]
        rows.append(Row("mean over others", _cells(means), rule=True))
    return Table("reenactment", "Reenactment", "avatar ← driver", COLUMNS, tuple(rows), NOTES)


def write_reenactments(found: Sequence[Reenactment], folder: Path) -> list[Path]:
    """Write `reenactment.json`, `.md` and `.csv`, and return their paths."""
    json_file, markdown, csv = (folder / name for name in FILES)
    listed = [one.as_dict() for one in found]
    write_json(json_file, {"schema": SCHEMA, "version": VERSION, "reenactments": listed})
    tables = [reenactment_table(found)]
    write_text(markdown, to_markdown(tables))
    write_text(csv, to_csv(tables))
    return [json_file, markdown, csv]


def _label(one: Reenactment) -> str:
    return f"{one.subject} ({display_name(one.method)}) ← {'itself' if one.is_own else one.driver}"


def _values(one: Reenactment) -> list[float | None]:
    found = one.fidelity.agreement
    measures = [found.correlation, found.slope, one.fidelity.expression_distance, one.pose_distance]
    return [*measures, one.jitter, one.driver_jitter, float(one.frames), float(one.lost)]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _cells(values: Sequence[float | None]) -> tuple[Cell, ...]:
    pairs = zip(values, COLUMNS, strict=True)
    return tuple(Cell("–" if value is None else f"{value:.{column.digits}f}", value) for value, column in pairs)
