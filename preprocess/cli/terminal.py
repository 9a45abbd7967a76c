"""Terminal output of `ggavatar-prep`: one live progress line per stage on a terminal, a few plain lines elsewhere."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ggavatar.text.clocked_lines import ClockedLines
from ggavatar.text.terminal import write_err, write_out
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Stage


class Terminal:
    """Prints progress and warnings to stderr and the summary to stdout."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._errors = Console(stderr=True, highlight=False, soft_wrap=True)
        self._warnings: list[str] = []
        self._notes: list[str] = []

    @contextmanager
    def stage(self, stage: Stage, skipped: bool) -> Iterator[_StageLine]:
        """The progress line of one stage, as a context manager."""
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(
            *columns, console=self._errors, transient=True, disable=self._quiet or not self._errors.is_terminal
        ) as progress:
            lines = None if self._quiet or self._errors.is_terminal or skipped else ClockedLines(stage.title)
            line = _StageLine(progress, lines, stage.title, self._warnings, self._notes)
            began = time.monotonic()
            try:
                yield line
            finally:
                if lines is not None:
                    lines.close()
        if not self._quiet:
            done = "unchanged" if skipped else f"{line.done or ''} {time.monotonic() - began:.1f} s".strip()
            write_err(f"{stage.title}: {done}")

    def summary(self, options: PrepOptions, results: Mapping[str, Mapping[str, Any]]) -> None:
        """Print the warnings, what was written, what was lost and the next command."""
        write_err(*(f"warning: {warning}" for warning in self._warnings))
        write_err(*(f"note: {note}" for note in self._notes if not self._quiet))
        lines = report_lines(results["doctor"])
        write_err(*(line for line in lines if not self._quiet or line.startswith("fault")))
        if self._quiet:
            return
        packed, folder = results["pack"], options.output_dir
        reasons = ", ".join(f"{count} {reason}" for reason, count in packed["dropped_reasons"].items())
        lost = f", {packed['dropped']} left out ({reasons})" if packed["dropped"] else ""
        write_out(f"capture with {packed['frames']} frames{lost}: {folder}")
        step = "next" if results["doctor"]["healthy"] else "not healthy: see above; to train nevertheless"
        write_out(f"{step}: ggavatar-train {shlex.quote(str(folder))} -o runs/{shlex.quote(folder.name)}")


class _StageLine:
    """Reporter of one stage."""

    def __init__(
        self, progress: Progress, lines: ClockedLines | None, title: str, warnings: list[str], notes: list[str]
    ) -> None:
        self._progress, self._lines, self._warnings, self._notes = progress, lines, warnings, notes
        self._task = progress.add_task(title, total=None)
        self.done = 0

    def advance(self, done: int, total: int | None) -> None:
        """Show the number of items done."""
        self.done = max(self.done, done)
        self._progress.update(self._task, completed=done, total=total)
        if self._lines is not None:
            self._lines.show(done, total)

    def warn(self, message: str) -> None:
        """Keep a warning for the summary."""
        self._warnings.append(message)

    def note(self, message: str) -> None:
        """Keep an assumption for the summary."""
        self._notes.append(message)


def report_lines(report: Mapping[str, Any]) -> list[str]:
    """The doctor's report as lines of text."""
    measures = report["measures"]
    lines = [
        f"{item['severity']}: {item['message']}"
        + (f" [ggavatar-prep {item['flag']}]" if str(item["flag"]).startswith("-") else "")
        for item in report["findings"]
    ]
    verdict = "healthy" if report["healthy"] else "not healthy"
    values = [f"silhouette IoU {measures['silhouette_iou']:.2f}", f"jitter {measures['jitter']['pixels']:.2f} px"]
    if measures.get("landmark_error_pixels") is not None:
        values.append(f"landmarks {measures['landmark_error_pixels']:.2f} px")
    return [*lines, f"doctor: {verdict} ({', '.join(values)})"]
