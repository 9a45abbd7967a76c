"""ggavatar-train: from a capture to a run folder."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import AvoidSubcommands, Positional, UseAppendAction, arg

from ggavatar.cli.run import run_command
from ggavatar.cli.version import answer_version
from ggavatar.errors import EXIT_FAILURE, EXIT_INTERRUPTED, EXIT_TERMINATED, InputError
from ggavatar.training import registry


@dataclass(frozen=True)
class Arguments:
    """Train an avatar on a capture."""

    capture: Positional[Path]
    """Folder written by ggavatar-prep."""
    method: Positional[str] = "ggavatar"
    """Method or variant; the list is below."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="RUN")] = None
    """Folder of the run; needed."""
    preset: Literal["default", "fast", "paper"] | None = None
    """default: for the device at hand; fast: a look within minutes; paper: the printed 120,000 iterations."""
    steps: int | None = None
    """Length of the training; every schedule scales with it."""
    seed: int | None = None
    """From which every random number derives; 42 by default."""
    device: str | None = None
    """auto, cpu, cuda or cuda:N."""
    backend: str | None = None
    """Rasteriser: auto, cpu, reference or gsplat."""
    split: str | None = None
    """Frames to train and test on: every-20th (as in the paper), last-350, last-500, ratio-0.8 or file:PATH."""
    background: str | None = None
    """white, black or R,G,B in 0 to 1."""
    max_gaussians: int | None = None
    """Largest number of Gaussians."""
    eval_every: int | None = None
    """Steps between two looks at test frames; 0 is never."""
    save_every: int | None = None
    """Steps between two checkpoints."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """A setting of the method, as field=value; may be repeated."""
    resume: bool = False
    """Go on with the run in the output folder."""
    overwrite: bool = False
    """Begin again in the output folder, removing the run that is there."""
    quiet: Annotated[bool, arg(aliases=["-q"])] = False
    """Print nothing but errors."""


def train() -> int:
    """Entry point of ggavatar-train."""
    answer_version("ggavatar-train")
    arguments = tyro.cli(AvoidSubcommands[Arguments], prog="ggavatar-train", description=_description())
    return run_command(lambda: _train(arguments))


def _description() -> str:
    methods = "\n".join(f"  {name}: {text}" for name, text in registry.names().items())
    return f"Train an avatar on a capture folder.\n\nMethods:\n{methods}"


def _train(arguments: Arguments) -> int:
    from ggavatar.training.session import Interrupted, train_run
    from ggavatar.training.trainer import TrainingError

    if arguments.output is None:
        raise InputError("expected a folder for the run; add -o RUN")
    if arguments.resume and arguments.overwrite:
        raise InputError("--resume and --overwrite exclude each other; choose one")
    try:
        step = train_run(arguments.capture, arguments.output, options_of(arguments), arguments.quiet)
    except Interrupted as stop:
        again = f"ggavatar-train {arguments.capture} -o {arguments.output} --resume"
        sys.stderr.write(f"stopped at step {stop.step}, saved; go on with: {again}\n")
        return EXIT_TERMINATED if stop.signal == 15 else EXIT_INTERRUPTED
    except TrainingError as error:
        sys.stderr.write(f"error: {error}\n")
        return EXIT_FAILURE
    if not arguments.quiet:
        sys.stdout.write(f"wrote {arguments.output} ({step} steps)\nnext: ggavatar-eval {arguments.output} --table\n")
    return 0


def options_of(arguments: Arguments) -> dict[str, Any]:
    """What the user asked for, by name; what was left open is absent."""
    names = (
        "method",
        "preset",
        "steps",
        "seed",
        "device",
        "backend",
        "split",
        "background",
        "max_gaussians",
        "eval_every",
        "save_every",
    )
    given = {name: getattr(arguments, name) for name in names}
    given |= {"set": list(arguments.set), "resume": arguments.resume, "overwrite": arguments.overwrite}
    return {name: value for name, value in given.items() if value is not None}


if __name__ == "__main__":
    sys.exit(train())
