"""ggavatar-train: train an avatar on a capture and write a run folder."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from ggavatar.cli.given import TO_TRAIN_ON, check_given
from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.progress import announce_start
from ggavatar.cli.run import run_command
from ggavatar.cli.training_help import BACKEND_NAMES, method_lines, training_defaults
from ggavatar.cli.typed import one_of
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
    """Method or variant, one of those listed; ggavatar if not given."""
    preset: Literal["default", "fast", "paper"] | None = None
    """default: suited to the device; fast: a preview within minutes; paper: 120,000 steps, as published."""
    steps: int | None = None
    """Number of training steps; every schedule scales with it."""
    seed: int | None = None
    """Seed of all random numbers."""
    device: str | None = None
    """Device of the training: auto, cpu, cuda, cuda:N or mps."""
    backend: str | None = None
    """Rasterizer: auto, cpu, triton, gsplat or reference; auto takes the fastest that can run."""
    split: str | None = None
    """Frames to train and test on: every-20th (as in the paper), last-350, last-500, ratio-0.8 or file:PATH."""
    background: str | None = None
    """Color behind the person: white, black, or R,G,B from 0 to 1."""
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


PAGE = CommandPage(
    program="ggavatar-train",
    options=Arguments,
    summary="Train an avatar on a capture and write a run folder. Ctrl-C saves the state; --resume continues it.",
    examples=(
        ("ggavatar-train captures/alice -o runs/alice", "an avatar by the paper's method, as suits this computer"),
        ("ggavatar-train captures/alice -o runs/quick --preset fast", "a preview within minutes"),
        ("ggavatar-train captures/alice gaussian_avatars -o runs/ga --steps 20000", "a baseline, of a given length"),
    ),
    groups={
        "what is trained": ("output", "preset", "steps", "seed", "split", "background", "max_gaussians", "set"),
        "where it is computed": ("device", "backend"),
        "during the training": ("eval_every", "save_every", "view", "quiet"),
        "an earlier run in the folder": ("resume", "overwrite"),
        "files of pretrained models": ("models", "offline"),
    },
    defaults=training_defaults,
    listing=method_lines,
    checks={"method": registry.check_name, "backend": one_of("--backend", BACKEND_NAMES)},
)


def train() -> int:
    """Entry point of ggavatar-train."""
    return run_command(lambda: _train(parse(PAGE)), Arguments)


def _train(arguments: Arguments) -> int:
    check_given(arguments.capture, TO_TRAIN_ON)
    announce_start(arguments.quiet)
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
