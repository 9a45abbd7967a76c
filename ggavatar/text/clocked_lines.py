"""Lines on stderr that come by the clock, so that no long step is silent and no log is flooded.

Where stderr is no terminal, some work has at most `LINES` lines: the first after `INTERVAL` seconds, then spread over
the time that is left, or, where that is unknown, after twice as long each time.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

from ggavatar.text.terminal import write_err

INTERVAL = 5.0
"""Least time between two lines, s."""
LINES = 10
"""Most lines of some work, the last of which says that it is done."""
TICK = 0.5
"""How often the clock is looked at, s."""


class RateMeter:
    """Mean speed of some work, and the time left at that speed."""

    def __init__(self, first: int = 0, started: float | None = None) -> None:
        """Measure from a moment at which `first` parts of the work are done.

        Args:
            first: Parts that are done.
            started: The moment, as of `time.monotonic`; now by default.
        """
        self._first = first
        self._started = time.monotonic() if started is None else started

    def left(self, done: int, total: int) -> float | None:
        """Seconds that the rest takes at the mean speed; None before the first part is done."""
        elapsed = time.monotonic() - self._started
        return elapsed * (total - done) / (done - self._first) if done > self._first else None

    def describe(self, done: int, total: int) -> tuple[str, str]:
        """Speed and time left, as in `("12.5 it/s", "ETA 1:30")`, when `done` of `total` has just been reached."""
        rate = (done - self._first) / max(time.monotonic() - self._started, 1e-9)
        return f"{rate:.1f} it/s", f"ETA {format_duration(self.left(done, total) or 0.0)}"


class LineSchedule:
    """When the next line is due; the last of `LINES` is left for the end."""

    def __init__(self, started: float) -> None:
        self._started = started
        self._next = started + INTERVAL
        self._unused = LINES - 1

    def is_due(self, now: float, left: float | None) -> bool:
        """Whether a line is to be written now, which counts as written then.

        Args:
            now: The time, as of `time.monotonic`.
            left: Seconds of work that are left, if known.
        """
        if now < self._next or self._unused == 0:
            return False
        self._unused -= 1
        pause = now - self._started if left is None else left / (self._unused + 1)
        self._next = now + max(pause, INTERVAL)
        return True


class ClockedLines:
    """The lines of some work, which come also while nothing of it gets done; `close` ends them."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._started = time.monotonic()
        self._schedule = LineSchedule(self._started)
        self._meter: RateMeter | None = None
        self._state: tuple[int, int | None] | None = None
        self._lock = threading.Lock()
        self._closed = threading.Event()
        threading.Thread(target=self._watch, name="progress", daemon=True).start()

    def show(self, done: int, total: int | None) -> None:
        """Take note of how much is done; None is an unknown total."""
        with self._lock:
            if self._meter is None:  # resumed work does not begin at zero
                self._meter = RateMeter(max(done - 1, 0), self._started)
            self._state = done, total
        self._write_if_due()

    def close(self) -> None:
        """Write nothing from now on."""
        with self._lock:
            self._closed.set()

    def elapsed(self) -> str:
        """Time since the work began, as text."""
        return format_duration(time.monotonic() - self._started)

    def _watch(self) -> None:
        while not self._closed.wait(TICK):
            self._write_if_due()

    def _write_if_due(self) -> None:
        with self._lock:
            done, total = self._state or (0, None)
            left = None if self._meter is None or total is None else self._meter.left(done, total)
            is_over = self._closed.is_set() or done == total
            if not is_over and self._schedule.is_due(time.monotonic(), left):
                write_err(self._line(done, total))
                sys.stderr.flush()

    def _line(self, done: int, total: int | None) -> str:
        if self._meter is None or total is None:
            return f"{self._title}{f' {done}' if done else ''} · at work for {self.elapsed()}"
        return " · ".join((f"{self._title} {done}/{total}", *self._meter.describe(done, total)))


@contextlib.contextmanager
def waiting(title: str, quiet: bool = False) -> Iterator[None]:
    """Show that some work of unknown length goes on: a spinner on a terminal, lines by the clock elsewhere.

    Args:
        title: What is being done, as in "preparing the avatar".
        quiet: Show nothing.
    """
    if quiet:
        yield
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.markup import escape

        with Console(stderr=True).status(escape(title)):
            yield
    else:
        lines = ClockedLines(title)
        try:
            yield
        finally:
            lines.close()


def format_duration(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
