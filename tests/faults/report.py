"""The table of counts: as text, and in docs/reliability.md, where a run replaces the lines of its rows."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.faults.case import Row
from tests.faults.ledger import Entry

BEGIN, END = "<!-- written by make faults -->", "<!-- end -->"
HEADING = (
    "| row | what is done | passes when | count | failures | minutes | date | commit | machine |",
    "|---|---|---|--:|--:|--:|---|---|---|",
)


@dataclass(frozen=True)
class Tally:
    """What a row came to.

    Attributes:
        count: Cases that were run.
        failures: Those that did not pass.
        seconds: Time of all cases together, s; some ran at a time.
        days, commits, machines: Of the cases, each once.
    """

    row: Row
    count: int
    failures: int
    seconds: float
    days: tuple[str, ...] = ()
    commits: tuple[str, ...] = ()
    machines: tuple[str, ...] = ()


def tally(row: Row, entries: Sequence[Entry]) -> Tally:
    """Count the outcomes of a row."""
    columns = [[entry.day for entry in entries], [entry.commit for entry in entries], [e.machine for e in entries]]
    distinct = (tuple(dict.fromkeys(column)) for column in columns)
    failures = sum(bool(entry.wrong) for entry in entries)
    return Tally(row, len(entries), failures, sum(entry.seconds for entry in entries), *distinct)


def text_line(found: Tally) -> str:
    """One line for the terminal."""
    return f"{found.row.name:14}  {found.count:6} cases  {found.failures:4} failures  {found.seconds / 60:5.1f} min"


def machine_class() -> str:
    """What kind of machine this is, without its name."""
    return f"{os.cpu_count()} cores {platform.machine()}, {platform.system()}, Python {platform.python_version()}"


def write_table(path: Path, tallies: Sequence[Tally], rows: Sequence[Row]) -> None:
    """Replace the lines of the tallied rows in the table of a document; lines of rows that are gone are removed,
    and of rows without a case kept as they are.

    Raises:
        ValueError: The document has no place for the table.
    """
    text = path.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BEGIN)
    old, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{path}: expected the lines {BEGIN} and {END}, found none; put them where the table goes")
    lines = {**_lines(old), **{found.row.name: _line(found) for found in tallies if found.count}}
    kept = [lines[row.name] for row in rows if row.name in lines]
    table = "\n".join((*HEADING, *kept))
    path.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}", encoding="utf-8")


def _lines(table: str) -> dict[str, str]:
    """The lines of a table by the name of their row."""
    cells = [(line.split("|")[1].strip(" `"), line) for line in table.splitlines() if line.startswith("| `")]
    return dict(cells)


def _line(found: Tally) -> str:
    row = found.row
    made = (
        " to ".join(sorted({min(found.days), max(found.days)})),
        ", ".join(found.commits),
        "; ".join(found.machines),
    )
    numbers = (f"{found.count:,}", f"{found.failures:,}", f"{found.seconds / 60:.1f}")
    return f"| {' | '.join((f'`{row.name}`', row.does, row.passes_when, *numbers, *made))} |"
