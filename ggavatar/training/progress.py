"""Progress of a training: the `Listener` protocol, and a line on the console that follows the steps.

On a terminal one line is updated in place; elsewhere a plain line is written every few seconds.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from ggavatar.text.terminal import write_out

PLAIN_INTERVAL = 10.0
"""Least time between two plain lines, s."""

LIVE_INTERVAL = 0.25
"""Least time between two updates of a line on a terminal, s."""


@runtime_checkable  # the tests' run-time type checker needs it
class Listener(Protocol):
    """Receives the events of a training."""

    def step(self, step: int, loss: Callable[[], float], gaussians: int) -> None:
        """A step is done; `loss` reads its loss, which waits for the device."""
        ...

    def evaluated(self, step: int, psnr: float) -> None:
        """Test frames have been evaluated; `psnr` is their mean, dB."""
        ...

    def close(self) -> None:
        """No more steps follow."""
        ...


class NullListener:
    """A listener that prints nothing."""

    def step(self, step: int, loss: Callable[[], float], gaussians: int) -> None:
        """Do nothing."""

    def evaluated(self, step: int, psnr: float) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class ConsoleListener:
    """A listener that keeps one line up to date on a terminal, and prints one every `PLAIN_INTERVAL` s elsewhere."""

    def __init__(self, first: int, total: int) -> None:
        self._total = total
        self._meter = RateMeter(first)
        self._last_output = time.monotonic()
        self._psnr: float | None = None
        self._live = _start_live_line() if sys.stdout.isatty() else None

    def step(self, step: int, loss: Callable[[], float], gaussians: int) -> None:
        """Show the state after a step, at most a few times a second."""
        now = time.monotonic()
        if step < self._total and now - self._last_output < (LIVE_INTERVAL if self._live else PLAIN_INTERVAL):
            return
        self._last_output = now
        text = self._text(step, loss(), gaussians)
        if self._live:
            self._live.update(text, refresh=True)
        else:
            write_out(text)
            sys.stdout.flush()

    def evaluated(self, step: int, psnr: float) -> None:
        """Remember the latest test PSNR for the line."""
        self._psnr = psnr

    def close(self) -> None:
        """Leave the last line on the terminal."""
        if self._live:
            self._live.stop()

    def _text(self, step: int, loss: float, gaussians: int) -> str:
        parts = [f"step {step}/{self._total}", *self._meter.describe(step, self._total), f"loss {loss:.4f}"]
        if self._psnr is not None:
            parts.append(f"test {self._psnr:.2f} dB")
        parts.append(f"{gaussians} Gaussians")
        peak = peak_memory_mib()
        if peak is not None:
            parts.append(f"{peak} MiB")
        return " · ".join(parts)


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

    def describe(self, done: int, total: int) -> tuple[str, str]:
        """Speed and time left, as in `("12.5 it/s", "ETA 1:30")`, when `done` of `total` has just been reached."""
        rate = (done - self._first) / max(time.monotonic() - self._started, 1e-9)
        left = (total - done) / rate if rate else 0.0
        return f"{rate:.1f} it/s", f"ETA {format_duration(left)}"


def _start_live_line() -> Any:
    """A line of rich that is updated in place."""
    from rich.live import Live

    live = Live("", auto_refresh=False, transient=False)
    live.start()
    return live


def format_duration(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def peak_memory_mib() -> int | None:
    """Largest resident memory of this process so far, MiB; None where it is unknown (Windows)."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak >> 20 if sys.platform == "darwin" else peak >> 10
