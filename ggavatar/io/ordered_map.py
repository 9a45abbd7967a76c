"""A function over many items by a few threads, results in order: pictures are decoded and encoded while others wait.

OpenCV, zlib and the disk let go of Python's lock, so threads suffice.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

AHEAD = 2
"""Results that may wait for their turn, beside one for each thread: what bounds the memory."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int | None = None, ahead: int = AHEAD
) -> Generator[Result]:
    """Results of a function that threads may call at once, in the order of the items.

    Items are taken in the caller's thread, a few ahead of the result that is asked for. The first exception ends it,
    at the place of its item; items that were not begun by then, or when the caller stops asking, are dropped.

    Args:
        function: Called once for each item, from any thread.
        items: May be endless or expensive: only a few are held at a time.
        threads: One for each core by default.
        ahead: Results that may wait for their turn, beside one for each thread.
    """
    threads = threads or cores()
    waiting: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="in-order")
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) >= threads + ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
