"""Just-in-time compiled kernels and the thread pool they run on.

Kernels release the interpreter lock and never start threads of their own: `run` hands them out in fixed chunks.
Results therefore do not depend on the number of threads, two callers never disturb each other, and a forked child
simply starts a new pool.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from numba.core.event import Event, Listener, register

from ggavatar.kernel_cache import KernelCache, cache_folder, source_digest

CACHE = None if os.environ.get("NUMBA_CACHE_DIR") else cache_folder()

OPTIONS = {
    "nogil": True,
    "error_model": "numpy",  # division by zero follows IEEE
    "boundscheck": False,
    "fastmath": {"contract", "nsz", "arcp"},  # contraction to fused multiply-add, but no reordering
}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel on its first call, cached on disk."""
    plain = inspect.unwrap(function)  # tests check types through decorators
    dispatcher = numba.njit(**OPTIONS)(plain)
    if CACHE is not None:  # Numba reads the folder when a cache is made
        numba.config.CACHE_DIR = str(CACHE / source_digest(Path(inspect.getfile(plain))))
    dispatcher._cache = KernelCache(plain)
    return dispatcher


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A helper of kernels, inlined by LLVM; caching it too would only double the work of the first compilation."""
    return numba.njit(inline="never", forceinline=True, **OPTIONS)(inspect.unwrap(function))


_pools: dict[int, ThreadPoolExecutor] = {}


def _forget_pools() -> None:
    """A forked child has none of its parent's threads."""
    _pools.clear()


os.register_at_fork(after_in_child=_forget_pools)


def run(task: Callable[[int], None], count: int) -> None:
    """Call `task(0)` … `task(count - 1)` on the threads torch may use, the caller too; raises what they raise."""
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
    try:
        work()
    finally:
        # One that has not begun (its thread is busy for another caller) is not waited for: the work is done without it.
        begun = [helper for helper in helpers if not helper.cancel()]
        for helper in begun:
            helper.exception()  # waits, as `wait` would, without an event of its own
    for helper in begun:
        helper.result()


def workers() -> int:
    """How many threads `share` uses at most."""
    return torch.get_num_threads()


def share(function: Callable[..., Any], pieces: int, *arguments: Any) -> None:
    """Let the threads call `function(tickets, *arguments)`, which takes pieces of work by raising `tickets[0]`.

    `tickets[1]` numbers the workers, for scratch memory of their own. This costs one call per thread, where
    `run` costs one per piece.
    """
    tickets = np.zeros(2, np.int64)
    run(lambda _: function(tickets, *arguments), min(workers(), pieces))


_told: set[str] = set()


def announce(what: str) -> None:
    """Say on stderr, once per process, that a first compilation is under way, since it takes seconds."""
    if what not in _told:
        _told.add(what)
        sys.stderr.write(f"compiling {what} for this processor (once; kept in {CACHE or numba.config.CACHE_DIR})\n")


class _Announcer(Listener):
    """Hears of every compilation that the cache could not spare."""

    def on_start(self, event: Event) -> None:
        module = event.data["dispatcher"].py_func.__module__ or ""
        if module.split(".")[0] in ("ggavatar", "preprocess", "evaluate"):
            announce("kernels")

    def on_end(self, event: Event) -> None:
        """Nothing to say."""


register("numba:compile", _Announcer())
