"""Captures from videos, and what is wrong with them."""

from __future__ import annotations

import contextlib
import dataclasses
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from ggavatar.data.capture import Capture
from ggavatar.errors import nearest
from ggavatar.head.files import load_head
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.held_folders import make_folder
from ggavatar.text.terminal import write_err
from preprocess.doctor.diagnosis import Diagnosis, examine
from preprocess.formats.registry import importer_names
from preprocess.options import PrepOptions, TrackingOptions
from preprocess.pipeline.pipeline import run_pipeline
from preprocess.pipeline.stage import Reporter, Stage
from preprocess.synthetic.demo import write_demo
from preprocess.synthetic.output_folder import check_demo_folder, prepare_demo_folder
from preprocess.synthetic.settings import DemoSettings, check_settings

_OF_THE_COMMAND = ("input", "output_dir", "quiet", "json", "strict", "tracker")


def prepare_capture(video: Path | str, output: Path | str, progress: bool = False, **options: Any) -> Capture:
    """Make a capture from a portrait video, as `ggavatar-prep` does: frames, crop, masks, tracking.

    Args:
        video: A video file, or a folder of PNG or JPEG frames.
        output: Capture folder to write.
        progress: Print a line when a stage is finished. Warnings of the stages are Python's either way; what the doctor
            finds in the capture, `check_capture` says.
        **options: Those of `ggavatar-prep` with underscores, such as `size=256`, `masks="masks"`,
            `tracking="tracking"`, `head_model="head.npz"` or `overwrite=True`; `focal`, `expressions` and `smooth` are
            those of the built-in tracker. Its `--help` says what each means.

    Raises:
        InputError: The input cannot be used; the message says what to change.
        TypeError: There is no such option.
    """
    own = [item.name for item in dataclasses.fields(PrepOptions) if item.name not in _OF_THE_COMMAND]
    tracker = [item.name for item in dataclasses.fields(TrackingOptions)]
    for name in options:
        if name not in (*own, *tracker):
            raise TypeError(
                f"prepare_capture() got an unexpected keyword argument {name!r}{nearest(name, [*own, *tracker])}"
            )
    tracking = TrackingOptions(**{name: value for name, value in options.items() if name in tracker})
    given = {name: _typed(name, value) for name, value in options.items() if name in own}
    run_pipeline(PrepOptions(Path(video), Path(output), tracker=tracking, **given), _reporting(progress))
    return Capture.open(output)


def check_capture(capture: Capture | Path | str) -> Diagnosis:
    """Examine a capture, as `ggavatar-doctor --dry-run` does: findings, and the flag of `ggavatar-prep` against each.

    Nothing is written. It takes a few seconds for a usual clip.

    Raises:
        InputError: It is no capture, or damaged.
    """
    opened = capture if isinstance(capture, Capture) else Capture.open(capture)
    return examine(opened, load_head(opened.head_path))


def make_demo(folder: Path | str, overwrite: bool = False, **settings: Any) -> Path:
    """Write a generated, license-free person, as `ggavatar-demo` does, and return the folder.

    It holds video.mp4, masks/, tracking/, head.npz and truth.npz.

    Args:
        folder: New, empty, or that of an earlier demo.
        overwrite: Replace an earlier demo.
        **settings: `identity` (1 to 5), `frames`, `size` (px, even), `noise` of the tracker, `background` and `seed`.

    Raises:
        InputError: The folder must not be written to.
        TypeError: There is no such setting.
    """
    known = [item.name for item in dataclasses.fields(DemoSettings)]
    for name in settings:
        if name not in known:
            raise TypeError(f"make_demo() got an unexpected keyword argument {name!r}{nearest(name, known)}")
    path = Path(folder)
    chosen = DemoSettings(**settings)
    check_settings(chosen)
    check_demo_folder(path, overwrite=overwrite)
    make_folder(path)
    with lock_folder(path):
        prepare_demo_folder(path, overwrite=overwrite)
        for _ in write_demo(path, chosen):
            pass
    return path


def list_importers() -> list[str]:
    """Names of the trackers' formats that `prepare_capture(tracking=…)` reads, those of installed plug-ins included."""
    return importer_names()


def _typed(name: str, value: Any) -> Any:
    """Paths may be given as texts, and several values as lists."""
    if name in ("tracking", "head_model", "models"):
        return None if value is None else Path(value)
    if name == "masks":
        return str(value)
    return tuple(value) if isinstance(value, list) else value


def _reporting(progress: bool) -> Callable[[Stage, bool], AbstractContextManager[Reporter]]:
    """What gives every stage its reporter: one that says nothing, or a line when it is finished, and warns."""

    @contextlib.contextmanager
    def report(stage: Stage, skipped: bool) -> Iterator[Reporter]:
        reporter, began = _Kept(), time.monotonic()
        yield reporter
        if progress:
            write_err(f"{stage.title}: {'unchanged' if skipped else f'{time.monotonic() - began:.1f} s'}")
        for message in reporter.warnings:
            warnings.warn(message, stacklevel=2)

    return report


class _Kept:
    """Keeps warnings; progress and assumptions are in the capture's records."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def advance(self, done: int, total: int | None) -> None:
        """Nothing."""

    def warn(self, message: str) -> None:
        """Keep the warning."""
        self.warnings.append(message)

    def note(self, message: str) -> None:
        """Nothing."""
