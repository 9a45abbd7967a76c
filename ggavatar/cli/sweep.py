"""ggavatar-sweep: train a grid of captures, methods and seeds, then measure it into one table.

Every cell is a run folder of its own, trained by ggavatar-train in a process of its own, here or on the machines of a
cluster (`ggavatar.sweeps.backends`). What is finished is skipped, what was broken off goes on, and a cell that fails
does not stop the others.
"""

from __future__ import annotations

import functools
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional, UseAppendAction, arg

from ggavatar.cli.run import run_command
from ggavatar.cli.version import handle_version_flag
from ggavatar.errors import EXIT_FAILURE, EXIT_INTERRUPTED, InputError, nearest
from ggavatar.sweeps.backends import Backend, Job, LocalProcesses, Outcome, RayCluster
from ggavatar.sweeps.cell import Cell, console_script, train_cell
from ggavatar.training import registry


@dataclass(frozen=True)
class Arguments:
    """Train and measure a grid of captures, methods and seeds; run it again to go on where it stopped."""

    captures: Positional[tuple[Path, ...]]
    """Folders written by ggavatar-prep."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="FOLDER")]
    """Where the runs (capture/method/seed) and the table go."""
    methods: tuple[str, ...] = ("ggavatar",)
    """Methods and variants, as in ggavatar-train."""
    seeds: tuple[int, ...] = (42,)
    """Seeds; the table gives mean and deviation over them."""
    backend: Literal["local", "ray"] = "local"
    """local: processes on this computer; ray: the machines of a Ray cluster, which share the output folder."""
    jobs: int = 1
    """local: cells trained at the same time."""
    gpus_per_job: float = 0.0
    """ray: GPUs of a cell; a fraction shares one."""
    cpus_per_job: float = 1.0
    """ray: cores of a cell."""
    retries: int = 0
    """How often a cell that failed goes on from its last checkpoint; bad input is not tried again."""
    preset: str | None = None
    """Passed to ggavatar-train, as the rest but --minutes and --train-only."""
    steps: int | None = None
    """Length of every training."""
    minutes: float | None = None
    """Wall time of every training instead: as many steps as fit, after a pilot of 100 steps beside each run."""
    split: str | None = None
    """Frames to train and test on."""
    device: str | None = None
    """Where to train."""
    max_gaussians: int | None = None
    """Largest number of Gaussians."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """A setting of every method, as field=value."""
    train_only: bool = False
    """Leave the measuring to a later ggavatar-eval."""


def main() -> int:
    """Entry point of ggavatar-sweep."""
    handle_version_flag("ggavatar-sweep")
    arguments = tyro.cli(Arguments, prog="ggavatar-sweep")
    return run_command(lambda: sweep(arguments))


def sweep(arguments: Arguments) -> int:
    """Train what is missing, report what failed, and print the table; the exit code."""
    backend = backend_of(arguments)
    cells = grid(arguments)
    outcomes = _train_all(cells, arguments, backend)
    if EXIT_INTERRUPTED in {outcome.code for outcome in outcomes}:
        return EXIT_INTERRUPTED
    trained = [cell.folder for cell in cells if cell.is_finished]
    sys.stdout.write(f"{len(trained)} of {len(cells)} cells trained in {arguments.output}\n")
    sys.stdout.flush()
    measured = _measure(trained, arguments) if trained and not arguments.train_only else 0
    return EXIT_FAILURE if len(trained) < len(cells) else measured


def backend_of(arguments: Arguments) -> Backend:
    """Where the cells are trained; `InputError` for flags that belong to the other backend."""
    if arguments.retries < 0 or arguments.gpus_per_job < 0 or arguments.jobs < 1:
        raise InputError("expected --jobs of 1 or more, --retries and --gpus-per-job of 0 or more")
    if arguments.backend == "ray":
        if arguments.jobs != 1:
            raise InputError("expected --jobs with --backend local only: Ray runs as many as the cluster has room for")
        return RayCluster(arguments.gpus_per_job, arguments.cpus_per_job, arguments.retries)
    if arguments.gpus_per_job:
        raise InputError("expected --gpus-per-job with --backend ray only; processes on one computer share its GPUs")
    return LocalProcesses(arguments.jobs, arguments.retries)


def _train_all(cells: Sequence[Cell], arguments: Arguments, backend: Backend) -> list[Outcome]:
    """Train the cells that are not finished and say how each ended, as it ends."""
    how = (tuple(_flags(arguments)), arguments.minutes, cores_of_a_cell(arguments))
    missing = {}
    for cell in cells:
        if cell.is_finished:
            sys.stdout.write(f"finished before: {cell.folder}\n")
        else:
            missing[str(cell.folder)] = cell
    sys.stdout.write(f"{len(missing)} of {len(cells)} cells to train\n")
    sys.stdout.flush()
    outcomes = []
    jobs = [Job(name, functools.partial(train_cell, cell, *how)) for name, cell in missing.items()]
    for outcome in backend.run(jobs) if jobs else ():
        outcomes.append(outcome)
        _tell(outcome, missing[outcome.job], len(outcomes), len(jobs))
    return outcomes


def _tell(outcome: Outcome, cell: Cell, done: int, total: int) -> None:
    """One line about a cell: on stderr if it failed."""
    if outcome.code == 0 and cell.is_finished:
        sys.stdout.write(f"{done} of {total}: trained {cell.folder}\n")
        sys.stdout.flush()
        return
    tries = f" after {outcome.attempts} attempts" if outcome.attempts > 1 else ""
    what = f"failed with exit code {outcome.code}{tries}"
    if outcome.code == 0:
        what = "ended well elsewhere, but its run is not here: -o must be a folder that all machines share"
    words = f" ({outcome.reason})" if outcome.reason else f"; its words are in {cell.log}"
    sys.stderr.write(f"{what}: {cell.folder}{words}\n")


def grid(arguments: Arguments) -> list[Cell]:
    """All cells, captures first; `InputError` for an unknown method or two captures of one name."""
    known = registry.names()
    for method in arguments.methods:
        if method not in known:
            raise InputError(f"unknown method {method!r}{nearest(method, known)}; known are {', '.join(known)}")
    output = arguments.output.resolve()  # jobs may run elsewhere
    names = [capture.resolve().name for capture in arguments.captures]
    if len(set(names)) != len(names):
        raise InputError(f"expected captures with different folder names, found {', '.join(names)}")
    return [
        Cell(capture.resolve(), method, seed, output / name / method / f"seed-{seed}")
        for capture, name in zip(arguments.captures, names, strict=True)
        for method in arguments.methods
        for seed in arguments.seeds
    ]


def _flags(arguments: Arguments) -> list[str]:
    """Flags for every ggavatar-train; `InputError` for a length given twice, or none that time can be."""
    minutes = arguments.minutes
    if minutes is not None and arguments.steps is not None:
        raise InputError("expected --steps or --minutes, found both; leave one out")
    if minutes is not None and not (math.isfinite(minutes) and minutes > 0):
        raise InputError(f"expected --minutes above 0, found {minutes:g}; give the wall time of one training")
    flags: list[str] = []
    for name in ("preset", "steps", "split", "device", "max_gaussians"):
        value = getattr(arguments, name)
        if value is not None:
            flags += ["--" + name.replace("_", "-"), str(value)]
    for assignment in arguments.set:
        flags += ["--set", assignment]
    return flags


def cores_of_a_cell(arguments: Arguments) -> int | None:
    """Cores of every training, so that those beside it are not in its way; None where there are none beside it."""
    if arguments.backend == "ray":
        return max(int(arguments.cpus_per_job), 1)
    return None if arguments.jobs == 1 else max((os.cpu_count() or 1) // arguments.jobs, 1)


def _measure(runs: Sequence[Path], arguments: Arguments) -> int:
    """The table over all trained cells, by ggavatar-eval."""
    layout = ["--layout", "ablation"] if len(arguments.captures) == 1 and len(arguments.methods) > 1 else []
    folder = str(arguments.output / "table")
    command = [console_script("ggavatar-eval"), *map(str, runs), "--table", "-o", folder, *layout]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
