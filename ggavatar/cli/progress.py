"""Progress of a command on stderr: a bar on a terminal, a plain line every few seconds elsewhere.

Commands that follow a training use `ggavatar.training.progress` instead, which also shows loss and memory.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ggavatar.text.terminal import write_err
from ggavatar.training.progress import PLAIN_INTERVAL, RateMeter, format_duration

ProgressCallback = Callable[[int, int], None]
"""Is called with (done, total) whenever a part of the work is done."""


@contextmanager
def show_progress(title: str, quiet: bool = False) -> Iterator[ProgressCallback]:
    """Gives a callback that shows how much of some work is done; a bar is removed with the context, also by an error.

    Args:
        title: What is being done, as in "rendering"; the clock starts now.
        quiet: Show nothing.
    """
    if quiet:
        yield lambda done, total: None
    elif sys.stderr.isatty():
        with _bar(title) as show:
            yield show
    else:
        yield _plain_lines(title)


def _plain_lines(title: str) -> ProgressCallback:
    started = last_output = time.monotonic()
    meter: RateMeter | None = None

    def show(done: int, total: int) -> None:
        nonlocal last_output, meter
        if meter is None:  # resumed work does not begin at zero
            meter = RateMeter(max(done - 1, 0), started)
        now = time.monotonic()
        if done == total:
            write_err(f"{title} {done}/{total} in {format_duration(now - started)}")
        elif now - last_output >= PLAIN_INTERVAL:
            last_output = now
            write_err(" · ".join((f"{title} {done}/{total}", *meter.describe(done, total))))
        sys.stderr.flush()

    return show


@contextmanager
def _bar(title: str) -> Iterator[ProgressCallback]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # stdout may be a file or a pipe: what is written to it meanwhile must not be moved to the terminal.
    bar = Progress(*columns, console=Console(stderr=True), redirect_stdout=False)
    task = bar.add_task(title, total=None)

    def show(done: int, total: int) -> None:
        bar.update(task, completed=done, total=total)
        bar.start()  # a bar appears with the first part that is done
        if done == total:
            bar.stop()

    try:
        yield show
    finally:
        bar.stop()
