"""`python -m tests.mutations`: plants faults one by one and reports those that no test notices.

Exit codes: 0 if every fault was noticed, 1 if one survived, could not be decided or no longer applies, 2 for wrong
arguments.
"""

from __future__ import annotations

import argparse
import datetime
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.mutations.catalogue import MUTATIONS, drawn, named
from tests.mutations.mutation import ROOT, Mutation, StaleMutation, copy_project
from tests.mutations.run import KILLED, Outcome, Settings, baseline_failure, run_all


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def chosen(arguments: argparse.Namespace, mutations: Sequence[Mutation]) -> list[Mutation]:
    """The mutations that the arguments ask for."""
    found = named(arguments.patterns, mutations) if arguments.patterns else list(mutations)
    return drawn(arguments.sample, arguments.date, found) if arguments.sample else found


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description=__doc__.splitlines()[0])
    parser.add_argument("patterns", nargs="*", help="names or files of mutations, with * for anything; default all")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="run only N, another N each day")
    parser.add_argument("--date", type=datetime.date.fromisoformat, default=datetime.date.today(), help="YYYY-MM-DD")
    parser.add_argument("--jobs", type=int, default=2, help="mutations at a time (2)")
    parser.add_argument("--limit", type=float, default=300.0, help="time limit of one mutation, s (300)")
    parser.add_argument("--list", action="store_true", help="list them and stop")
    return parser.parse_args(arguments)


def line(outcome: Outcome) -> str:
    """One row of the table."""
    first = outcome.detail.splitlines()[0] if outcome.detail and outcome.verdict == KILLED else ""
    return f"{outcome.verdict:9}  {outcome.seconds:5.0f} s  {outcome.mutation.name:44}  {first.rpartition('/')[2]}"


def main(arguments: Sequence[str] | None = None, mutations: Sequence[Mutation] = MUTATIONS, root: Path = ROOT) -> int:
    """Run mutations of the project in `root`; see the module."""
    wanted = parse(arguments)
    mutations = chosen(wanted, mutations)
    if not mutations:
        say(f"expected names or files of mutations, found none for {' '.join(wanted.patterns)}; --list shows all")
        return 2
    if wanted.list:
        say("\n".join(f"{mutation.name:44}  {mutation.file}" for mutation in mutations))
        return 0
    settings, began = Settings(max(wanted.jobs, 1), wanted.limit), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        unchanged = Path(folder) / "project"
        copy_project(root, unchanged)
        try:
            for mutation in mutations:
                mutation.planted((unchanged / mutation.file).read_text(encoding="utf-8"))
        except StaleMutation as error:
            say(str(error))
            return 1
        if output := baseline_failure(mutations, unchanged, settings):
            say(f"{output}\nthe tests fail on the unchanged project; mend that first")
            return 1
        say(f"the tests pass on the unchanged project ({time.monotonic() - began:.0f} s); {len(mutations)} mutations")
        outcomes = run_all(mutations, unchanged, settings, lambda outcome: say(line(outcome)))
    alive = [outcome for outcome in outcomes if outcome.verdict != KILLED]
    for outcome in alive:
        say(f"\n{outcome.verdict}: {outcome.mutation}\n{outcome.detail}")
    say(f"{len(outcomes) - len(alive)} of {len(outcomes)} mutations were noticed ({time.monotonic() - began:.0f} s)")
    return 1 if alive else 0


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"  # read when the fork server loads torch
    sys.exit(main())
