"""The reenactments that a command asks for: every run driven by its own test frames and by every other capture."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from evaluate.options import Options
from evaluate.reenactment.measure import Reenactment, measure_reenactment
from ggavatar.errors import InputError
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.render.backends import resolve_device
from ggavatar.training.run_folder import holds_run, open_run

Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None] | None]]
"""Shows a progress bar with a title while the context is open."""


def measure_pairs(options: Options, show_progress: Progress) -> list[Reenactment]:
    """Measure every run, driven by its own test frames and by the captures of --reenact that are not its own.

    Raises:
        InputError: There is no run, or a driver cannot be used.
    """
    folders = [path for path in options.runs if not is_gaussian_file(path) and holds_run(path)]
    if not folders:
        raise InputError("--reenact drives avatars: expected run folders of ggavatar-train, found none")
    finder, found = ModelFinder(options.models, options.offline), []
    for folder in folders:
        run = open_run(folder, resolve_device(options.device))
        others = [path for path in options.reenact if path.resolve() != run.capture.folder.resolve()]
        for source in (None, *others):
            title = f"driving {run.capture.subject} by {_name(source)}"
            with show_progress(title) as report:
                found.append(measure_reenactment(run, source, finder, report=report or _silent))
    return found


def _name(source: Path | None) -> str:
    return "its own test frames" if source is None else source.resolve().name


def _silent(done: int, total: int) -> None:
    """Report nothing."""
