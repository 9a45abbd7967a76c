"""ggavatar-train: train an avatar on a capture and write a run folder."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import AvoidSubcommands, Positional, UseAppendAction, arg

from ggavatar.cli.run import run_command
from ggavatar.cli.version import handle_version_flag
from ggavatar.cli.viewer_process import viewer_beside
from ggavatar.errors import EXIT_FAILURE, EXIT_INTERRUPTED, EXIT_TERMINATED, InputError
from ggavatar.pretrained.folders import export_choice
from ggavatar.text.terminal import write_err, write_out
from ggavatar.training import registry


@dataclass(frozen=True)
class Arguments:
    """Train an avatar on a capture."""

    capture: Positional[Path]
    """Folder written by ggavatar-prep."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder of the run."""
    method: Annotated[Positional[str | None], arg(metavar="METHOD")] = None
    """Method or variant, as listed above; ggavatar if not given."""
    preset: Literal["default", "fast", "paper"] | None = None
    """default: suited to the device; fast: a preview within minutes; paper: 120,000 steps, as published."""
    steps: int | None = None
    """Number of training steps; every schedule scales with it."""
    seed: int | None = None
    """Seed of all random numbers; 42 if not given."""
    device: str | None = None
    """auto, cpu, cuda, cuda:N or mps."""
    backend: str | None = None
    """Rasterizer: auto, cpu, triton, gsplat or reference."""
    split: str | None = None
    """Frames to train and test on: every-20th (as in the paper), last-350, last-500, ratio-0.8 or file:PATH."""
    background: str | None = None
    """white, black, or R,G,B from 0 to 1."""
    max_gaussians: int | None = None
    """Largest number of Gaussians."""
    eval_every: int | None = None
    """Steps between two evaluations on test frames; 0 disables evaluation."""
    save_every: int | None = None
    """Steps between two checkpoints."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """A setting of the method, as field=value; may be repeated."""
    resume: bool = False
    """Continue the run in the output folder from its last checkpoint."""
    overwrite: bool = False
    """Replace the run in the output folder."""
    models: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder searched first for the weights of the perceptual loss, before $GGAVATAR_MODELS and the user's cache."""
    offline: bool = False
    """Never download weights, as $GGAVATAR_OFFLINE=1."""
    view: bool = False
    """Show the avatar in a browser while it trains (docs/viewer.md)."""
    quiet: Annotated[bool, arg(aliases=["-q"])] = False
    """Print errors only."""


def train() -> int:
    """Entry point of ggavatar-train."""
    return run_command(lambda: _train(_parse()))


def _parse() -> Arguments:
    handle_version_flag("ggavatar-train")
    return tyro.cli(AvoidSubcommands[Arguments], prog="ggavatar-train", description=_description())


def _description() -> str:
    methods = "\n".join(f"  {name}: {text}" for name, text in registry.names().items())
    unusable = "".join(f"\n\nNote: {text}." for text in registry.problems().values())
    return f"Train an avatar on a capture folder.\n\nMethods:\n{methods}{unusable}"


def _train(arguments: Arguments) -> int:
    from ggavatar.training.finite_guard import TrainingError
    from ggavatar.training.session import TrainingInterrupted, train_run

    if arguments.resume and arguments.overwrite:
        raise InputError("--resume and --overwrite are mutually exclusive; leave one out")
    export_choice(arguments.models, arguments.offline)
    try:
        with viewer_beside(arguments.output) if arguments.view else contextlib.nullcontext():
            step = train_run(arguments.capture, arguments.output, options_of(arguments), arguments.quiet)
    except TrainingInterrupted as stop:
        command = f"ggavatar-train {arguments.capture} -o {arguments.output} --resume"
        write_err(f"stopped and saved at step {stop.step}; resume with: {command}")
        return EXIT_TERMINATED if stop.signal == signal.SIGTERM else EXIT_INTERRUPTED
    except TrainingError as error:
        write_err(f"error: {error}")
        return EXIT_FAILURE
    if not arguments.quiet:
        write_out(f"wrote {arguments.output} ({step} steps)", f"next: ggavatar-eval {arguments.output} --table")
    return 0


def options_of(arguments: Arguments) -> dict[str, Any]:
    """The options that the user has given, by name: every field but those that say where and how loudly."""
    given = {field.name: getattr(arguments, field.name) for field in dataclasses.fields(arguments)}
    given["set"], given["view"] = list(arguments.set), arguments.view or None
    elsewhere = ("capture", "output", "models", "offline", "quiet")
    return {name: value for name, value in given.items() if name not in elsewhere and value is not None}


if __name__ == "__main__":
    sys.exit(train())
