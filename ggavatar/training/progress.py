"""Progress of a training: the `Listener` protocol, and a line on the console that follows the steps.

On a terminal one line is updated in place; elsewhere a few plain lines are written (`ggavatar.text.clocked_lines`).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from ggavatar.text.clocked_lines import LineSchedule, RateMeter
from ggavatar.text.terminal import write_out

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
    """A listener that keeps one line up to date on a terminal, and prints some elsewhere."""

    def __init__(self, first: int, total: int) -> None:
        self._total = total
        self._meter = RateMeter(first)
        self._last_output = time.monotonic()
        self._schedule = LineSchedule(self._last_output)
        self._psnr: float | None = None
        self._live = _start_live_line() if sys.stdout.isatty() else None

    def step(self, step: int, loss: Callable[[], float], gaussians: int) -> None:
        """Show the state after a step, at most a few times a second."""
        if step < self._total and not self._is_due(step):
            return
        self._last_output = time.monotonic()
        text = self._text(step, loss(), gaussians)
        if self._live:
            self._live.update(text, refresh=True)
        else:
            write_out(text)
            sys.stdout.flush()

    def _is_due(self, step: int) -> bool:
        """Whether the line is to be updated, or another one written."""
        now = time.monotonic()
        if self._live:
            return now - self._last_output >= LIVE_INTERVAL
        return self._schedule.is_due(now, self._meter.left(step, self._total))

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


def _start_live_line() -> Any:
    """A line of rich that is updated in place."""
    from rich.live import Live

    live = Live("", auto_refresh=False, transient=False)
    live.start()
    return live


def peak_memory_mib() -> int | None:
    """Largest resident memory of this process so far, MiB; None where it is unknown (Windows)."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak >> 20 if sys.platform == "darwin" else peak >> 10
