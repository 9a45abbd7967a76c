"""Worker processes from a fork server: one for every thread that asks; one that hangs or dies is replaced."""

from __future__ import annotations

import functools
import itertools
import multiprocessing
import os
import shutil
import threading
from pathlib import Path
from typing import Any

from tests.faults.hostile.fixture import FAULT, Fixture, Reading
from tests.faults.hostile.worker import work

PRELOADED = ("torch", "numba", "cv2", "av", "scipy.spatial.transform", "skimage.metrics", "matplotlib.pyplot")
"""What workers start with; none of our own modules, whose import is watched like everything else."""
HUNG, WARM_UP = 300.0, 600.0
"""Seconds on the clock, of a machine that may have other work, after which a reading hangs, and that loading and a
first reading of a valid tree may take; what a reading may take of the processor is in `worker.py`."""


@functools.cache
def _context() -> Any:
    for name, value in (("OMP_NUM_THREADS", "1"), ("NUMBA_NUM_THREADS", "1"), ("MPLBACKEND", "agg")):
        os.environ.setdefault(name, value)  # read when the fork server loads torch
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOADED))
    return context


class Pool:
    """Opens fixtures; may be used by several threads.

    Args:
        originals: Folder of the valid trees.
        folder: Folder for the workers' copies.
    """

    def __init__(self, originals: Path, folder: Path) -> None:
        self._originals, self._folder = originals, folder
        self._numbers = itertools.count()
        self._idle: list[_Worker] = []
        self._guard = threading.Lock()

    def read(self, fixture: Fixture) -> Reading:
        """What becomes of a fixture."""
        with self._guard:
            worker = self._idle.pop() if self._idle else None
        if worker is None:
            worker = _Worker(self._originals, self._folder / f"worker-{next(self._numbers):04d}")
        reading = worker.ask(fixture)
        if worker.is_alive:
            with self._guard:
                self._idle.append(worker)
        else:
            worker.end()
        return reading

    def close(self) -> None:
        """End all workers."""
        while self._idle:
            self._idle.pop().end()


class _Worker:
    """One process and its folder."""

    def __init__(self, originals: Path, sandbox: Path) -> None:
        self._sandbox = sandbox
        sandbox.mkdir(parents=True)
        self._connection, theirs = multiprocessing.Pipe()
        self._process = _context().Process(target=work, args=(theirs, originals, sandbox), daemon=True)
        self._process.start()
        theirs.close()
        self.is_alive = True

    def ask(self, fixture: Fixture) -> Reading:
        """Have a fixture read; afterwards the worker may be dead."""
        try:
            self._connection.send(fixture)
            failure = self._connection.recv() if self._connection.poll(WARM_UP) else f"no end within {WARM_UP:.0f} s"
            if failure:
                raise RuntimeError(f"{fixture.reader} cannot read the unchanged tree {fixture.base}: {failure}")
            if self._connection.poll(HUNG):
                return self._connection.recv()
        except (EOFError, ConnectionError):
            self._process.join(5)
            self.is_alive = False
            return Reading(FAULT, f"the process died with exit code {self._process.exitcode}")
        self.is_alive = False
        return Reading(FAULT, f"no end within {HUNG:.0f} s")

    def end(self) -> None:
        """Kill the process and remove its folder."""
        self._connection.close()
        self._process.kill()
        self._process.join()
        shutil.rmtree(self._sandbox, ignore_errors=True)
