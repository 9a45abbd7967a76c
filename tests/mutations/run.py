"""Runs mutations: each in a copy of its own, with the tests that should see it, some at a time."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tests.mutations.mutation import ROOT, Mutation, copy_project

KILLED, SURVIVED, UNDECIDED = "killed", "SURVIVED", "UNDECIDED"

PYTEST = (sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--no-header")
FAILED, TOO_LONG = 1, -1
"""Exit codes: pytest's for failed tests, and ours for a run beyond the time limit."""


@dataclass(frozen=True)
class Outcome:
    """What became of one mutation.

    Attributes:
        verdict: `KILLED`, `SURVIVED`, or `UNDECIDED` where pytest could not run the tests, or took too long.
        seconds: Time of the run, s.
        detail: The first test that failed, or the end of the output of an undecided run.
    """

    mutation: Mutation
    verdict: str
    seconds: float
    detail: str


@dataclass(frozen=True)
class Settings:
    """How mutations are run.

    Attributes:
        jobs: Mutations at a time.
        limit: Time limit of one, s.
        root: The project.
    """

    jobs: int = 2
    limit: float = 300.0
    root: Path = ROOT


def run_tests(folder: Path, tests: Iterable[str], limit: float) -> tuple[int, str]:
    """Exit code and output of pytest in a copy of the project; `TOO_LONG` beyond the limit."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    environment.pop("PYTEST_ADDOPTS", None)
    try:
        ran = subprocess.run(
            [*PYTEST, *tests], cwd=folder, env=environment, timeout=limit, capture_output=True, text=True, check=False
        )
    except subprocess.TimeoutExpired:
        return TOO_LONG, f"no end within {limit:.0f} s"
    return ran.returncode, ran.stdout + ran.stderr


def run_mutation(mutation: Mutation, settings: Settings) -> Outcome:
    """Plant one mutation in a new copy and run its tests.

    Raises:
        StaleMutation: It no longer applies.
    """
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        copy = Path(folder) / "project"
        copy_project(settings.root, copy)
        mutation.plant(copy)
        code, output = run_tests(copy, mutation.tests, settings.limit)
    verdict = {FAILED: KILLED, 0: SURVIVED}.get(code, UNDECIDED)
    seen = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    detail = seen[1] if verdict == KILLED and seen else "" if verdict != UNDECIDED else output[-2000:]
    return Outcome(mutation, verdict, time.monotonic() - began, detail)


def baseline_failure(mutations: Sequence[Mutation], settings: Settings) -> str:
    """The output of the mutations' tests on the unchanged project if they fail; empty if they pass."""
    tests = sorted({test for mutation in mutations for test in mutation.tests})
    parts = [part for part in (tests[start :: settings.jobs] for start in range(settings.jobs)) if part]
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        copy = Path(folder) / "project"
        copy_project(settings.root, copy)
        with ThreadPoolExecutor(settings.jobs) as pool:
            ends = list(pool.map(lambda part: run_tests(copy, part, settings.limit * len(mutations)), parts))
    return "\n".join(output for code, output in ends if code != 0)


def run_all(mutations: Sequence[Mutation], settings: Settings, report: Callable[[Outcome], None]) -> list[Outcome]:
    """Run mutations, `settings.jobs` at a time; `report` is called with each outcome in the order of the list."""
    found = []
    with ThreadPoolExecutor(settings.jobs) as pool:
        for outcome in pool.map(lambda mutation: run_mutation(mutation, settings), mutations):
            report(outcome)
            found.append(outcome)
    return found
