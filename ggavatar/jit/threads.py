"""The thread pool that compiled kernels run on.

Kernels release the GIL and never start threads of their own: `run` and `run_workers` distribute fixed pieces of work.
Results therefore do not depend on the number of threads, two callers never disturb each other, and a forked child
starts a new pool.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch

_pools: dict[int, ThreadPoolExecutor] = {}


def _forget_pools() -> None:
    """Start anew in a forked child, which has none of its parent's threads."""
    _pools.clear()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_forget_pools)


def run(task: Callable[[int], None], count: int) -> None:
    """Call `task(0)` … `task(count - 1)` on as many threads as torch may use, the caller's included.

    Exceptions of the tasks are raised here.
    """
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
        # Helpers that have not started (their thread is busy for another caller) are canceled: all work is done.
        started = [helper for helper in helpers if not helper.cancel()]
        for helper in started:
            helper.exception()  # waits like `concurrent.futures.wait`, but without creating an event
    for helper in started:
        helper.result()


def max_workers() -> int:
    """Largest number of threads that `run_workers` uses."""
    return torch.get_num_threads()


def run_workers(function: Callable[..., Any], pieces: int, *arguments: Any) -> None:
    """Call `function(tickets, *arguments)` once per thread; it takes pieces of work by incrementing `tickets[0]`.

    Workers number themselves by incrementing `tickets[1]`, to have scratch memory of their own. This costs one call per
    thread, where `run` costs one per piece.
    """
    tickets = np.zeros(2, np.int64)
    run(lambda _: function(tickets, *arguments), min(max_workers(), pieces))
