"""Just-in-time compiled kernels and the thread pool they run on.

Kernels release the interpreter lock and never start threads of their own: `run` hands them out in fixed chunks. Results therefore do not
depend on the number of threads, two callers never disturb each other, and a forked child simply starts a new pool.
"""

from __future__ import annotations

import inspect
import os
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch


def cache_folder() -> Path:
    """The per-user folder for compiled kernels: $GGAVATAR_CACHE, else the user's cache, else a folder in the temporary directory."""
    wanted = os.environ.get("GGAVATAR_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    for base in (Path(wanted), Path(tempfile.gettempdir())):
        folder = base / "ggavatar" / "kernels"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="ggavatar-kernels-"))


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(cache_folder())


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel on its first call, cached on disk. Division by zero follows IEEE, contraction to fused multiply-add is allowed."""
    options = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": {"contract", "nsz", "arcp"}}
    return numba.njit(**options)(inspect.unwrap(function))  # unwrapped: tests check types through decorators


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A helper of kernels, inlined by LLVM."""
    options = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": {"contract", "nsz", "arcp"}}
    return numba.njit(inline="never", forceinline=True, **options)(inspect.unwrap(function))


_pools: dict[int, ThreadPoolExecutor] = {}


def _forget_pools() -> None:
    """A forked child has none of its parent's threads."""
    _pools.clear()


os.register_at_fork(after_in_child=_forget_pools)


def run(task: Callable[[int], None], count: int) -> None:
    """Call `task(0)` … `task(count - 1)`, on as many threads as torch uses; the caller works too. Raises what a task raised."""
    threads = min(torch.get_num_threads(), count)
    if threads <= 1:
        for index in range(count):
            task(index)
        return
    pool = _pools.get(threads)
    if pool is None:
        pool = _pools.setdefault(threads, ThreadPoolExecutor(threads - 1, thread_name_prefix="ggavatar"))
    numbers = iter(range(count))

    def work() -> None:
        for index in numbers:
            task(index)

    helpers: list[Future[None]] = [pool.submit(work) for _ in range(threads - 1)]
    work()
    for helper in helpers:
        if not helper.cancel():
            helper.result()


def workers() -> int:
    """How many threads `share` uses at most."""
    return torch.get_num_threads()


def share(function: Callable[..., Any], pieces: int, *arguments: Any) -> None:
    """Let the threads call `function(tickets, *arguments)`, which takes pieces of work by raising `tickets[0]` until none is left.

    `tickets[1]` numbers the workers, for scratch memory of their own. This costs one call per thread, where `run` costs one per piece.
    """
    tickets = np.zeros(2, np.int64)
    run(lambda _: function(tickets, *arguments), min(workers(), pieces))


def announce(what: str) -> None:
    """Say on stderr that a first compilation is under way, since it takes seconds."""
    sys.stderr.write(f"compiling {what} for this processor (once; kept in {numba.config.CACHE_DIR})\n")
