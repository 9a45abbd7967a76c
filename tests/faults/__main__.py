"""`python -m tests.faults`: injects faults and says where something was lost, let in or went wrong.

Exit codes: 0 if every case passed, 1 if one did not, 2 for wrong arguments.
"""

from __future__ import annotations

import argparse
import datetime
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.faults.bench import Bench
from tests.faults.case import Case, Outcome, Row
from tests.faults.catalogue import ROWS, named
from tests.faults.ledger import Ledger, sources_digest
from tests.faults.report import machine_class, tally, text_line, write_table
from tests.faults.run import run_row


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__.splitlines()[0])
    parser.add_argument("--row", nargs="+", default=[], metavar="NAME", help="rows, with * for anything; default all")
    parser.add_argument("--count", type=int, help="cases of each row (default: its own number)")
    parser.add_argument("--sample", action="store_true", help="a few cases of each row, others each day")
    parser.add_argument("--seed", type=int, help="of everything random (default: 0; with --sample, the date)")
    parser.add_argument("--case", type=int, nargs="+", help="only those with these seeds, as failures print them")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time (2)")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="DIR",
        help="where outcomes are kept: cases that passed with the "
        "same code are not run again, and the table counts all that are there",
    )
    parser.add_argument("--no-run", action="store_true", help="run nothing, only count what --results holds")
    parser.add_argument("--write", type=Path, metavar="FILE", help="document whose table is brought up to date")
    parser.add_argument("--list", action="store_true", help="list the cases and stop")
    return parser.parse_args(arguments)


def cases_of(row: Row, wanted: argparse.Namespace) -> list[Case]:
    """The cases of a row for the number and the seed that the arguments ask for."""
    count = wanted.count if wanted.count is not None else row.sample if wanted.sample else row.count
    seed = wanted.seed if wanted.seed is not None else datetime.date.today().toordinal() if wanted.sample else 0
    return list(row.cases(count, seed) if count else ())


def show(outcome: Outcome) -> None:
    """Print what is wrong with a case, if anything is."""
    if outcome.wrong:
        say("\n  ".join((f"FAILED {outcome.case.title}; expected: {outcome.case.expectation}", *outcome.wrong)))


def main(arguments: Sequence[str] | None = None, rows: Sequence[Row] = ROWS) -> int:
    """Run the rows that the arguments name; see the module."""
    wanted = parse(arguments)
    chosen = named(wanted.row, rows)
    if not chosen:
        known = ", ".join(row.name for row in rows)
        say(f"expected names of rows, found none for {' '.join(wanted.row)}; known are {known}")
        return 2
    cases = {row.name: cases_of(row, wanted) for row in chosen}
    asked = {
        name: [case for case in found if wanted.case is None or case.seed in wanted.case]
        for name, found in cases.items()
    }
    if wanted.list:
        say("\n".join(case.title for found in asked.values() for case in found))
        return 0
    with tempfile.TemporaryDirectory(prefix="ggavatar-faults-", ignore_cleanup_errors=True) as folder:
        bench = Bench(Path(folder), jobs=max(wanted.jobs, 1))
        ledger = Ledger(wanted.results or Path(folder) / "results")
        for row in () if wanted.no_run else chosen:
            inject(row, asked[row.name], bench, ledger)
        tallies = [tally(row, ledger.entries(row.name, cases[row.name])) for row in chosen]
    for found in tallies:
        if found.count:
            say(text_line(found))
    if wanted.write is not None:
        write_table(wanted.write, tallies, rows)
    return 1 if any(found.failures for found in tallies) else 0


def inject(row: Row, cases: Sequence[Case], bench: Bench, ledger: Ledger) -> None:
    """Run the cases of a row that have not passed yet, and write down what became of each."""
    remaining = ledger.open_cases(row.name, cases, sources_digest())
    if len(remaining) < len(cases):
        say(f"{row.name}: {len(cases) - len(remaining)} of {len(cases)} cases have passed with this code before")

    def note(outcome: Outcome) -> None:
        show(outcome)
        ledger.add(outcome, datetime.date.today().isoformat(), machine_class())

    run_row(row, remaining, bench, note)


if __name__ == "__main__":
    sys.exit(main())
