"""Runs mutations: each in a copy of its own, with the tests that should see it, some at a time.

A run costs little more than its tests: it starts in a process of Python's fork server, which has torch and its like
loaded, and its copy brings the bytecode along that the tests of the unchanged project have left.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.mutations.mutation import ROOT, Mutation

KILLED, SURVIVED, UNDECIDED = "killed", "SURVIVED", "UNDECIDED"

FAILED, TOO_LONG = 1, -1
"""Exit codes: pytest's for failed tests, and ours for a run beyond the time limit."""

FLAGS = ("-q", "-x", "-p", "no:cacheprovider", "--no-header", "-o", "addopts=--import-mode=importlib --strict-markers")
"""Flags of pytest in place of the project's own: without the check of shapes, which would take most of the time, so
that a fault is noticed by what a test expects."""
PACKAGES = ("ggavatar", "preprocess", "evaluate", "tests")
PRELOADED = ("torch._dynamo", "numba", "scipy.spatial.transform", "scipy.special", "skimage.metrics", "cv2")
"""Modules that many tests import; none of ours, and no plugin of pytest."""


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
        preloaded: Modules that the processes start with.
    """

    jobs: int = 2
    limit: float = 300.0
    preloaded: tuple[str, ...] = PRELOADED


def run_tests(folder: Path, tests: Iterable[str], limit: float, preloaded: Sequence[str] = ()) -> tuple[int, str]:
    """Exit code and output of pytest in a copy of the project; `TOO_LONG` beyond the limit."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory(prefix="mutation-output-") as place:
        output = Path(place) / "output.txt"
        arguments = (str(folder), (*FLAGS, *tests), environment, str(output))
        process = _context(tuple(preloaded)).Process(target=_pytest, args=arguments)
        process.start()
        process.join(limit)
        late = process.is_alive()
        if late:
            process.kill()
            process.join()
        code = TOO_LONG if late else process.exitcode
        process.close()
        text = output.read_text(encoding="utf-8", errors="replace") if output.is_file() else ""
    return code, f"{text}\nno end within {limit:.0f} s" if late else text


@functools.cache
def _context(preloaded: tuple[str, ...]) -> Any:
    """Where processes come from: a fork server, or new interpreters on systems without one."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    # torch._dynamo imports triton, which decides then whether kernels are interpreted, as the tests want them.
    os.environ.setdefault("TRITON_INTERPRET", "1")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preloaded))
    return context


def _pytest(folder: str, arguments: Sequence[str], environment: Mapping[str, str], output: str) -> None:
    """Run pytest on the copy in `folder` and end the process with its exit code; nothing of the checkout is used."""
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.path[:] = [folder, *(entry for entry in sys.path if entry and Path(entry).resolve() != ROOT)]
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
        del sys.modules[name]
    import pytest

    code = pytest.main(list(arguments))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(code))


def run_mutation(mutation: Mutation, unchanged: Path, settings: Settings) -> Outcome:
    """Plant one mutation in a new copy of the unchanged project and run its tests.

    Raises:
        StaleMutation: It no longer applies.
    """
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        copy = Path(folder) / "project"
        shutil.copytree(unchanged, copy)
        mutation.plant(copy)
        code, output = run_tests(copy, mutation.tests, settings.limit, settings.preloaded)
    verdict = {FAILED: KILLED, 0: SURVIVED}.get(code, UNDECIDED)
    seen = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    detail = seen[1] if verdict == KILLED and seen else "" if verdict != UNDECIDED else output[-2000:]
    return Outcome(mutation, verdict, time.monotonic() - began, detail)


def baseline_failure(mutations: Sequence[Mutation], unchanged: Path, settings: Settings) -> str:
    """The output of the mutations' tests on the unchanged project if they fail; empty if they pass."""
    tests = sorted({test for mutation in mutations for test in mutation.tests})
    parts = [part for part in (tests[start :: settings.jobs] for start in range(settings.jobs)) if part]
    limit = settings.limit * len(mutations)
    with ThreadPoolExecutor(settings.jobs) as pool:
        ends = list(pool.map(lambda part: run_tests(unchanged, part, limit, settings.preloaded), parts))
    return "\n".join(output or "no output" for code, output in ends if code != 0)


def run_all(
    mutations: Sequence[Mutation], unchanged: Path, settings: Settings, report: Callable[[Outcome], None]
) -> list[Outcome]:
    """Run mutations, `settings.jobs` at a time; `report` is called with each outcome in the order of the list."""
    found = []
    with ThreadPoolExecutor(settings.jobs) as pool:
        for outcome in pool.map(lambda mutation: run_mutation(mutation, unchanged, settings), mutations):
            report(outcome)
            found.append(outcome)
    return found
