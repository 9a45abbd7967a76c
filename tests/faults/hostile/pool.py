"""Opens cases in worker processes from a fork server; a worker that hangs or dies is replaced, its case a fault."""

from __future__ import annotations

import functools
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tests.faults.hostile.case import FAULT, Case, Outcome
from tests.faults.hostile.worker import MAX_SECONDS, work

PRELOADED = ("torch", "numba", "cv2", "av", "scipy.spatial.transform", "skimage.metrics", "matplotlib")
GRACE, WARM_UP = 10.0, 300.0
"""Seconds beyond the limit after which a case hangs, and that loading and reading the unchanged trees may take."""
BATCH = 250


@functools.cache
def _context() -> Any:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOADED))
    return context


def open_all(
    cases: Sequence[Case], bases: Path, jobs: int = 1, each: Callable[[Outcome], object] = lambda outcome: None
) -> list[Outcome]:
    """Open every case, `jobs` workers at a time; outcomes in the order of the cases."""
    ordered = sorted(range(len(cases)), key=lambda index: (cases[index].base, cases[index].reader))
    batches = [ordered[start : start + BATCH] for start in range(0, len(ordered), BATCH)]
    outcomes: dict[int, Outcome] = {}

    def run(batch: Sequence[int]) -> None:
        found = _open_batch([cases[index] for index in batch], bases, each)
        outcomes.update(zip(batch, found, strict=True))

    with ThreadPoolExecutor(jobs) as threads:
        list(threads.map(run, batches))
    return [outcomes[index] for index in range(len(cases))]


def _open_batch(cases: Sequence[Case], bases: Path, each: Callable[[Outcome], object]) -> list[Outcome]:
    found: list[Outcome] = []
    while len(found) < len(cases):
        with tempfile.TemporaryDirectory(prefix="hostile-", ignore_cleanup_errors=True) as sandbox:
            for outcome in _open_until_dead(cases[len(found) :], bases, Path(sandbox) / "work"):
                found.append(outcome)
                each(outcome)
    return found


def _open_until_dead(cases: Sequence[Case], bases: Path, sandbox: Path) -> Any:
    """Outcomes of one worker, until it has opened all or a case was the end of it."""
    receiver, sender = multiprocessing.Pipe(duplex=False)
    environment = {"OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    os.environ.update({name: value for name, value in environment.items() if name not in os.environ})
    process = _context().Process(target=work, args=(sender, bases, sandbox, list(cases)), daemon=True)
    process.start()
    sender.close()
    current: Case | None = None
    done = 0
    try:
        while done < len(cases):
            limit = WARM_UP if current is None else MAX_SECONDS + GRACE
            if not receiver.poll(limit):
                yield _ended(current, f"no end within {limit:.0f} s")
                return
            try:
                kind, content = receiver.recv()
            except EOFError:
                process.join(5)
                yield _ended(current, f"the process died with exit code {process.exitcode}")
                return
            if kind == "begin":
                current = cases[content]
            else:
                done += 1
                yield content
    finally:
        process.kill()
        process.join()
        receiver.close()


def _ended(case: Case | None, how: str) -> Outcome:
    if case is None:
        raise RuntimeError(f"the worker did not begin: {how}")
    return Outcome(case.name, FAULT, f"fault: {how}")
