"""Progress of a command on stderr: a bar on a terminal, a plain line every few seconds elsewhere.

Commands that follow a training use `ggavatar.training.progress` instead, which also shows loss and memory.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from ggavatar.training.progress import PLAIN_INTERVAL, RateMeter, format_duration

if TYPE_CHECKING:
    from rich.progress import Progress

ProgressCallback = Callable[[int, int], None]
"""Is called with (done, total) whenever a part of the work is done."""

_running_bar: Progress | None = None


def show_progress(title: str, quiet: bool = False) -> ProgressCallback:
    """A callback that shows how much of some work is done.

    Args:
        title: What is being done, as in "rendering"; the clock starts now.
        quiet: Show nothing.
    """
    if quiet:
        return lambda done, total: None
    return _bar(title) if sys.stderr.isatty() else _plain_lines(title)


def stop_progress() -> None:
    """Remove the bar of work that has failed, and restore the cursor; does nothing if no bar is on the terminal."""
    global _running_bar
    if _running_bar is not None:
        _running_bar.stop()
        _running_bar = None


def _plain_lines(title: str) -> ProgressCallback:
    started = last_output = time.monotonic()
    meter: RateMeter | None = None

    def show(done: int, total: int) -> None:
        nonlocal last_output, meter
        if meter is None:  # resumed work does not begin at zero
            meter = RateMeter(max(done - 1, 0), started)
        now = time.monotonic()
        if done == total:
            sys.stderr.write(f"{title} {done}/{total} in {format_duration(now - started)}\n")
        elif now - last_output >= PLAIN_INTERVAL:
            last_output = now
            sys.stderr.write(" · ".join((f"{title} {done}/{total}", *meter.describe(done, total))) + "\n")
        sys.stderr.flush()

    return show


def _bar(title: str) -> ProgressCallback:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # stdout may be a file or a pipe: what is written to it meanwhile must not be moved to the terminal.
    bar = Progress(*columns, console=Console(stderr=True), redirect_stdout=False)
    task = bar.add_task(title, total=None)

    def show(done: int, total: int) -> None:
        global _running_bar
        bar.update(task, completed=done, total=total)
        if _running_bar is not bar:
            stop_progress()
            bar.start()
            _running_bar = bar
        if done == total:
            stop_progress()

    return show
