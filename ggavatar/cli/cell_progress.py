"""The cells of a sweep on stderr while they are trained: one live line on a terminal, else lines by the clock."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Sequence

from ggavatar.sweeps.cell import Cell
from ggavatar.sweeps.watching import CellWatch, short_name
from ggavatar.text.clocked_lines import TICK, LineSchedule
from ggavatar.text.terminal import printable, write_err


@contextlib.contextmanager
def show_cells(cells: Sequence[Cell]) -> Iterator[CellWatch]:
    """Say which cells are being trained and how far they are, until the block ends; it adds to `done` what has ended.

    Args:
        cells: Those to be trained.
    """
    watch = CellWatch(cells)
    closed = threading.Event()
    show = (_LiveLine if sys.stderr.isatty() else _Lines)(watch, closed)
    thread = threading.Thread(target=show, name="cells", daemon=True)
    thread.start()
    try:
        yield watch
    finally:
        closed.set()
        thread.join()


class _Lines:
    """Writes each cell as it begins, then now and then where it is."""

    def __init__(self, watch: CellWatch, closed: threading.Event) -> None:
        self._watch, self._closed = watch, closed
        self._schedules: dict[str, LineSchedule] = {}

    def __call__(self) -> None:
        while not self._closed.wait(TICK):
            self.write()

    def write(self) -> None:
        """Write what is due."""
        now = time.monotonic()
        for cell in self._watch.begun():
            write_err(f"training {short_name(cell)} (its output: {cell.log})")
        running = self._watch.describe()
        if running and self._schedule().is_due(now, None):
            write_err(running)
        sys.stderr.flush()

    def _schedule(self) -> LineSchedule:
        """That of the cells that are running; others begin a new one, as a stage of their own."""
        key = " ".join(str(cell.folder) for cell in self._watch.running())
        return self._schedules.setdefault(key, LineSchedule(time.monotonic()))


class _LiveLine:
    """Keeps one line up to date."""

    def __init__(self, watch: CellWatch, closed: threading.Event) -> None:
        self._watch, self._closed = watch, closed

    def __call__(self) -> None:
        from rich.console import Console
        from rich.markup import escape

        with Console(stderr=True).status("starting the trainings") as line:
            while not self._closed.wait(TICK):
                line.update(escape(printable(self._watch.describe() or "starting the trainings")))
