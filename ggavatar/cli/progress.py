"""Progress of a command on stderr: a bar on a terminal, a plain line now and then elsewhere; neither waits for work.

Commands that follow a training use `ggavatar.training.progress` instead, which also shows loss and memory.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ggavatar.text.clocked_lines import ClockedLines
from ggavatar.text.terminal import write_err

ProgressCallback = Callable[[int, int], None]
"""Is called with (done, total) whenever a part of the work is done."""
PATIENCE = 1.0
"""After this time a bar appears even if no part is done, s."""


def announce_start(quiet: bool = False) -> None:
    """Say that torch is being loaded, which takes seconds, unless it is here already or nothing is to be said."""
    if not quiet and "torch" not in sys.modules:
        write_err("starting: loading torch")
        sys.stderr.flush()


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
        lines = ClockedLines(title)
        try:
            yield _with_an_end(title, lines)
        finally:
            lines.close()


def _with_an_end(title: str, lines: ClockedLines) -> ProgressCallback:
    """Lines by the clock, and one when all is done."""

    def show(done: int, total: int) -> None:
        lines.show(done, total)
        if done == total:
            write_err(f"{title} {done}/{total} in {lines.elapsed()}")
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
    closed, lock = threading.Event(), threading.Lock()

    def start() -> None:
        with lock:
            if not closed.is_set():
                bar.start()

    def show(done: int, total: int) -> None:
        bar.update(task, completed=done, total=total)
        start()  # a bar appears with the first part that is done, or when that takes long
        if done == total:
            bar.stop()

    late = threading.Timer(PATIENCE, start)
    late.daemon = True
    late.start()
    try:
        yield show
    finally:
        late.cancel()
        with lock:
            closed.set()
        bar.stop()
