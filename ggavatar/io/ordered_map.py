"""Apply a function to many items on a few threads and yield the results in order, for instance to decode images.

OpenCV, zlib and file access release the GIL, so threads suffice. `Executor.map` would take all items at once; here only
a few are held at a time.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

MAX_QUEUED_RESULTS = 2
"""Results that may be queued in addition to one per thread; bounds the memory."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def available_cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def ordered_map(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    threads: int | None = None,
    ahead: int = MAX_QUEUED_RESULTS,
) -> Generator[Result]:
    """Yield the results of a thread-safe function in the order of the items.

    Items are taken in the caller's thread, a few ahead of the result that is requested. An exception is raised in place
    of its item's result and ends the iteration; items not yet started then, or when the caller stops iterating, are
    dropped. A caller whose `function` uses something that is closed later closes this generator first: that waits for
    the threads.

    Args:
        function: Called once per item, from any thread.
        items: May be endless or expensive: only a few are held at a time.
        threads: One for each core by default.
        ahead: Results that may wait for their turn, beside one for each thread.
    """
    threads = threads or available_cores()
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
