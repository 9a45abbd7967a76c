"""What a training says while it runs.

One live line on a terminal, plain lines elsewhere, JSON lines in the run folder.
"""

from __future__ import annotations

import resource
import sys
import time
from typing import Any, Protocol, runtime_checkable

PLAIN_EVERY = 10.0
"""Seconds between plain lines."""


@runtime_checkable
class Listener(Protocol):
    """Something that is told how a training goes."""

    def step(self, step: int, loss: float, gaussians: int) -> None:
        """A step is done."""
        ...

    def evaluated(self, step: int, psnr: float) -> None:
        """Test frames were looked at."""
        ...

    def close(self) -> None:
        """No more steps follow."""
        ...


class Silence:
    """A listener that says nothing."""

    def step(self, step: int, loss: float, gaussians: int) -> None:
        """Say nothing."""

    def evaluated(self, step: int, psnr: float) -> None:
        """Say nothing."""

    def close(self) -> None:
        """Say nothing."""


class Line:
    """A listener that keeps one line up to date on a terminal, and writes one every `PLAIN_EVERY` seconds elsewhere."""

    def __init__(self, first: int, total: int) -> None:
        self._first, self._total = first, total
        self._started = self._spoken = time.monotonic()
        self._psnr: float | None = None
        self._live = _live() if sys.stdout.isatty() else None

    def step(self, step: int, loss: float, gaussians: int) -> None:
        """Show the state after a step, at most a few times a second."""
        now = time.monotonic()
        if step < self._total and now - self._spoken < (0.25 if self._live else PLAIN_EVERY):
            return
        self._spoken = now
        text = self._text(step, loss, gaussians, now)
        if self._live:
            self._live.update(text, refresh=True)
        else:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()

    def evaluated(self, step: int, psnr: float) -> None:
        """Remember the newest test PSNR for the line."""
        self._psnr = psnr

    def close(self) -> None:
        """Leave the last line standing."""
        if self._live:
            self._live.stop()

    def _text(self, step: int, loss: float, gaussians: int, now: float) -> str:
        rate = (step - self._first) / max(now - self._started, 1e-9)
        left = (self._total - step) / rate if rate else 0.0
        parts = [
            f"step {step}/{self._total}",
            f"{rate:.1f} it/s",
            f"ETA {clock(left)}",
            f"loss {loss:.4f}",
            f"{gaussians} Gaussians",
            f"{peak_memory_mib()} MiB",
        ]
        if self._psnr is not None:
            parts.insert(4, f"test {self._psnr:.2f} dB")
        return " · ".join(parts)


def _live() -> Any:
    """A line that is rewritten in place."""
    from rich.live import Live

    live = Live("", auto_refresh=False, transient=False)
    live.start()
    return live


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def peak_memory_mib() -> int:
    """Largest resident memory of this process so far, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak >> 20 if sys.platform == "darwin" else peak >> 10
