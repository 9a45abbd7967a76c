"""The thread pool that compiled kernels run on.

Kernels release the GIL and never start threads of their own: `run` hands them out in fixed chunks. Results therefore
do not depend on the number of threads, two callers never disturb each other, and a forked child starts a new pool.
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
    """A forked child has none of its parent's threads."""
    _pools.clear()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
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
