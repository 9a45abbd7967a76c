"""The table of counts: as text, and in docs/reliability.md, where a run replaces the lines of its rows."""

from __future__ import annotations

import datetime
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.faults.case import Outcome, Row

BEGIN, END = "<!-- written by make faults -->", "<!-- end -->"
HEADING = (
    "| row | what is done | passes when | count | failures | minutes | date | machine |",
    "|---|---|---|--:|--:|--:|---|---|",
)


@dataclass(frozen=True)
class Tally:
    """What a row came to.

    Attributes:
        count: Cases that were run.
        failures: Those that did not pass.
        seconds: Wall time of the row, s.
    """

    row: Row
    count: int
    failures: int
    seconds: float


def tally(row: Row, outcomes: Sequence[Outcome], seconds: float) -> Tally:
    """Count the outcomes of a row."""
    return Tally(row, len(outcomes), sum(bool(outcome.wrong) for outcome in outcomes), seconds)


def text_line(found: Tally) -> str:
    """One line for the terminal."""
    return f"{found.row.name:14}  {found.count:6} cases  {found.failures:4} failures  {found.seconds / 60:5.1f} min"


def machine_class() -> str:
    """What kind of machine this is, without its name."""
    return f"{os.cpu_count()} cores {platform.machine()}, {platform.system()}, Python {platform.python_version()}"


def write_table(path: Path, tallies: Sequence[Tally], rows: Sequence[Row], day: datetime.date) -> None:
    """Replace the lines of the tallied rows in the table of a document; lines of rows that are gone are removed.

    Raises:
        ValueError: The document has no place for the table.
    """
    text = path.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BEGIN)
    old, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{path}: expected the lines {BEGIN} and {END}, found none; put them where the table goes")
    lines = _with_lines(_lines(old), tallies, day)
    kept = [lines[row.name] for row in rows if row.name in lines]
    table = "\n".join((*HEADING, *kept))
    path.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}", encoding="utf-8")


def _lines(table: str) -> dict[str, str]:
    """The lines of a table by the name of their row."""
    cells = [(line.split("|")[1].strip(" `"), line) for line in table.splitlines() if line.startswith("| `")]
    return dict(cells)


def _with_lines(lines: Mapping[str, str], tallies: Sequence[Tally], day: datetime.date) -> dict[str, str]:
    machine = machine_class()
    new = {
        found.row.name: f"| `{found.row.name}` | {found.row.does} | {found.row.passes_when} | {found.count:,} | "
        f"{found.failures:,} | {found.seconds / 60:.1f} | {day.isoformat()} | {machine} |"
        for found in tallies
    }
    return {**lines, **new}
