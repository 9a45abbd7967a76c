"""Captures and runs: open, train, reopen."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from ggavatar.api.options import check_options
from ggavatar.data.capture import Capture
from ggavatar.formats.any_avatar import open_avatar
from ggavatar.render.backends import resolve_device
from ggavatar.training import registry
from ggavatar.training.run_folder import Run
from ggavatar.training.same_capture import change_since_training
from ggavatar.training.session import TrainingInterrupted, train_run


class TrainOptions(TypedDict, total=False):
    """What a training may be given; what is left out has the default of its preset, or of the run that it resumes."""

    preset: Literal["default", "fast", "paper"]
    """default (suited to the device), fast (a preview within minutes) or paper (120,000 steps, as published)."""
    steps: int
    """Number of steps; every schedule scales with it."""
    seed: int
    """Seed of all random numbers; 42."""
    device: str
    """auto, cpu, cuda, cuda:N or mps."""
    backend: str
    """Rasterizer: auto, cpu, triton, gsplat or reference."""
    split: str
    """Frames to train and test on: every-20th, last-350, last-500, ratio-0.8 or file:PATH."""
    background: str
    """white, black, or R,G,B from 0 to 1."""
    max_gaussians: int
    """Largest number of Gaussians."""
    eval_every: int
    """Steps between two evaluations on test frames; 0 disables them."""
    save_every: int
    """Steps between two checkpoints."""
    settings: Mapping[str, Any]
    """Settings of the method, by the names in its `Config`."""
    resume: bool
    """Continue the run in the folder from its last checkpoint."""
    overwrite: bool
    """Replace the run in the folder."""
    progress: bool
    """Print the progress."""


def open_capture(folder: Path | str) -> Capture:
    """Open a capture folder and check that it is complete and consistent; pixels are read when they are asked for.

    Raises:
        InputError: A file is missing, damaged or inconsistent with another; the message names it.
    """
    return Capture.open(folder)


def train(
    capture: Capture | Path | str, output: Path | str, method: str = "ggavatar", **options: Unpack[TrainOptions]
) -> Run:
    """Train an avatar on a capture, as `ggavatar-train` does, and open the run.

    Args:
        capture: The capture or its folder.
        output: Folder of the run.
        method: A method or variant, one of `list_methods()`.
        **options: As in `TrainOptions`.

    Raises:
        InputError: The capture, the method or an option cannot be used.
        KeyboardInterrupt: Ctrl-C; the state is saved, and `resume=True` continues.
    """
    check_options("train", options, TrainOptions)
    given: dict[str, Any] = {**options, "method": method}
    is_quiet = not given.pop("progress", False)
    given["set"] = assignments(given.pop("settings", {}))
    folder = capture.folder if isinstance(capture, Capture) else Path(capture)
    try:
        train_run(folder, Path(output), given, quiet=is_quiet)
    except TrainingInterrupted as stop:
        raise KeyboardInterrupt(f"saved at step {stop.step}; continue with resume=True") from stop
    return open_run(output, device=options.get("device", "auto"), capture=folder)


def open_run(path: Path | str, device: str = "auto", step: int | None = None, capture: Path | str | None = None) -> Run:
    """Open a run folder, or an avatar file, which has neither photographs nor other checkpoints.

    Args:
        path: The run folder or avatar file.
        device: auto, cpu, cuda, cuda:N or mps.
        step: Step of the checkpoint; the newest if not given.
        capture: Where the capture of the run is now, if it was moved away from the run.

    Raises:
        InputError: Neither of the two, or damaged, or its capture is not found.

    Warns:
        UserWarning: The capture has changed since the run was trained on it.
    """
    moved = None if capture is None else Path(capture)
    run = open_avatar(Path(path), resolve_device(device), step, capture=moved)
    if changed := change_since_training(run):
        warnings.warn(changed, stacklevel=2)
    return run


def list_methods() -> dict[str, str]:
    """Names of all methods and variants with a line on each, those of installed plug-ins included."""
    return registry.names()


def assignments(settings: Mapping[str, Any]) -> list[str]:
    """Settings as the texts `name=value` that `--set` takes."""
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(_plain(value))}" for name, value in settings.items()
    ]


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
