"""ggavatar-sweep: train a grid of captures, methods and seeds, then evaluate all cells in one table.

Every cell has a run folder of its own and is trained by ggavatar-train in a process of its own, here or on the machines
of a cluster (`ggavatar.sweeps.backends`). Every capture, method and flag is checked before the first training. Finished
cells are skipped, interrupted ones are resumed, and a cell that fails does not stop the others.
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

from tyro.conf import Positional, UseAppendAction, arg

from ggavatar.cli.cell_progress import show_cells
from ggavatar.cli.given import TO_TRAIN_ON, check_given
from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.progress import announce_start
from ggavatar.cli.run import run_command
from ggavatar.cli.training_help import method_lines, training_defaults
from ggavatar.errors import EXIT_FAILURE, EXIT_INTERRUPTED, InputError
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.held_folders import make_folder
from ggavatar.sweeps.backends import Backend, CellTraining, LocalProcesses, Outcome, RayCluster
from ggavatar.sweeps.cell import Cell, find_console_script, train_cell
from ggavatar.text.terminal import write_err, write_out
from ggavatar.training import registry

PASSED_ON = ("preset", "steps", "split", "device", "background", "max_gaussians")
"""Flags that every ggavatar-train gets if they are given."""


@dataclass(frozen=True)
class Arguments:
    """Train and evaluate a grid of captures, methods and seeds; run the same command again to resume it."""

    captures: Positional[tuple[Path, ...]]
    """Folders written by ggavatar-prep."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="FOLDER")]
    """Folder for the runs (capture/method/seed) and the table."""
    methods: tuple[str, ...] = ("ggavatar",)
    """Methods and variants, as in ggavatar-train."""
    seeds: tuple[int, ...] = (42,)
    """Seeds; the table shows mean and standard deviation over them."""
    backend: Literal["local", "ray"] = "local"
    """local: processes on this computer; ray: the machines of a Ray cluster, which share the output folder."""
    jobs: int = 1
    """local: number of cells trained at the same time."""
    gpus_per_job: float | None = None
    """ray: GPUs per cell, a fraction shares one; by default one where the cluster has any and --device is not cpu."""
    cpus_per_job: float = 1.0
    """ray: cores per cell."""
    retries: int = 0
    """How many times a failed cell is resumed from its last checkpoint; invalid input is not retried."""
    preset: Literal["default", "fast", "paper"] | None = None
    """default: suited to the device; fast: a preview within minutes; paper: 120,000 steps, as published."""
    steps: int | None = None
    """Number of steps of every training; every schedule scales with it."""
    minutes: float | None = None
    """Minutes of wall time per training, instead of --steps; a 100-step pilot measures the speed."""
    split: str | None = None
    """Frames to train and test on."""
    device: str | None = None
    """Device to train on."""
    background: str | None = None
    """white, black, or R,G,B from 0 to 1."""
    max_gaussians: int | None = None
    """Largest number of Gaussians."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """A setting of every method, as field=value."""
    train_only: bool = False
    """Do not evaluate; run ggavatar-eval later."""


PAGE = CommandPage(
    program="ggavatar-sweep",
    options=Arguments,
    summary="Train and evaluate a grid of captures, methods and seeds; run the same command again to resume it.",
    examples=(
        ("ggavatar-sweep captures/alice captures/bob -o sweep", "our method on two captures, in one table"),
        ("ggavatar-sweep captures/alice -o sweep --methods ggavatar gaussian_avatars --minutes 10", "at equal time"),
        ("ggavatar-sweep captures/alice -o sweep --seeds 1 2 3 --jobs 3", "mean and deviation over three seeds"),
    ),
    groups={
        "the grid": ("output", "methods", "seeds", "train_only"),
        "every training": ("preset", "steps", "minutes", "split", "device", "background", "max_gaussians", "set"),
        "where the trainings run": ("backend", "jobs", "gpus_per_job", "cpus_per_job", "retries"),
    },
    defaults=lambda: {name: value for name, value in training_defaults().items() if name != "backend"},
    listing=method_lines,
    checks={"methods": registry.check_name},
)


def main() -> int:
    """Entry point of ggavatar-sweep."""
    return run_command(lambda: sweep(parse(PAGE)), Arguments)


def sweep(arguments: Arguments) -> int:
    """Train the missing cells, report failures, evaluate into a table, and return the exit code."""
    for capture in arguments.captures:
        check_given(capture, TO_TRAIN_ON)
    backend = make_backend(arguments)
    cells = grid(arguments)
    check(arguments, cells)
    make_folder(arguments.output)
    with lock_folder(arguments.output):
        return _train_and_evaluate(cells, arguments, backend)


def _train_and_evaluate(cells: Sequence[Cell], arguments: Arguments, backend: Backend) -> int:
    outcomes = _train_all(cells, arguments, backend)
    if EXIT_INTERRUPTED in {outcome.code for outcome in outcomes}:
        return EXIT_INTERRUPTED
    trained = [cell.folder for cell in cells if cell.is_finished]
    write_out(f"{len(trained)} of {len(cells)} cells trained in {arguments.output}")
    sys.stdout.flush()
    evaluated = _evaluate(trained, arguments) if trained and not arguments.train_only else 0
    return EXIT_FAILURE if len(trained) < len(cells) else evaluated


def check(arguments: Arguments, cells: Sequence[Cell]) -> None:
    """Check everything that can be checked before the first training.

    Raises:
        InputError: The folder, a flag, a capture, a method or a setting cannot be used.
    """
    if arguments.output.exists() and not arguments.output.is_dir():
        raise InputError(f"{arguments.output}: expected a folder for the runs, found a file; choose another with -o")
    _flags(arguments)
    for program in ("ggavatar-train",) if arguments.train_only else ("ggavatar-train", "ggavatar-eval"):
        find_console_script(program)
    announce_start()
    from ggavatar.sweeps.checks import check_cells  # torch, which --help does without

    names = [*PASSED_ON, "set"]
    options = {name: value for name in names if (value := getattr(arguments, name)) not in (None, ())}
    if arguments.backend == "ray":
        options["device"] = "cpu"  # the devices are those of other machines, whose trainings check them
    check_cells(cells, options)


def make_backend(arguments: Arguments) -> Backend:
    """The backend that trains the cells.

    Raises:
        InputError: A flag is out of range, or belongs to the other backend.
    """
    if arguments.retries < 0 or (arguments.gpus_per_job or 0) < 0 or arguments.jobs < 1:
        raise InputError("expected --jobs of 1 or more, --retries and --gpus-per-job of 0 or more")
    if arguments.backend == "ray":
        if arguments.jobs != 1:
            raise InputError(
                "expected --jobs with --backend local only: Ray runs as many cells as the cluster can hold"
            )
        gpus = 0.0 if arguments.gpus_per_job is None and arguments.device == "cpu" else arguments.gpus_per_job
        return RayCluster(gpus, arguments.cpus_per_job, arguments.retries)
    if arguments.gpus_per_job:
        raise InputError("expected --gpus-per-job with --backend ray only; processes on one computer share its GPUs")
    return LocalProcesses(arguments.jobs, arguments.retries, visible_gpus(arguments))


def visible_gpus(arguments: Arguments) -> tuple[str, ...]:
    """CUDA devices to distribute cells on: those this process sees, if cells run side by side and may use any."""
    if arguments.jobs == 1 or arguments.device not in (None, "auto", "cuda"):
        return ()
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        return tuple(name.strip() for name in named.split(",") if name.strip())
    import torch  # --help does without

    return tuple(map(str, range(torch.cuda.device_count())))


def _train_all(cells: Sequence[Cell], arguments: Arguments, backend: Backend) -> list[Outcome]:
    """Train the cells that are not finished and report each as it ends."""
    settings = (tuple(_flags(arguments)), arguments.minutes, cores_per_cell(arguments))
    missing = {}
    for cell in cells:
        if cell.is_finished:
            write_out(f"already finished: {cell.folder}")
        else:
            missing[str(cell.folder)] = cell
    write_out(f"{len(missing)} of {len(cells)} cells to train")
    sys.stdout.flush()
    outcomes = []
    trainings = [CellTraining(name, functools.partial(train_cell, cell, *settings)) for name, cell in missing.items()]
    with show_cells(list(missing.values())) as watch:
        for outcome in backend.run(trainings) if trainings else ():
            outcomes.append(outcome)
            watch.done.add(missing[outcome.cell].folder)
            _report(outcome, missing[outcome.cell], len(outcomes), len(trainings))
    return outcomes


def _report(outcome: Outcome, cell: Cell, done: int, total: int) -> None:
    """Print one line about a cell, on stderr if it failed."""
    if outcome.code == 0 and cell.is_finished:
        write_out(f"{done} of {total}: trained {cell.folder}")
        sys.stdout.flush()
        return
    tries = f" after {outcome.attempts} attempts" if outcome.attempts > 1 else ""
    failure = f"failed with exit code {outcome.code}{tries}"
    if outcome.code == 0:
        failure = "trained on another machine, but its run is not found here (all machines must share the folder of -o)"
    detail = f" ({outcome.reason})" if outcome.reason else f"; see {cell.log}"
    write_err(f"{failure}: {cell.folder}{detail}")


def grid(arguments: Arguments) -> list[Cell]:
    """All cells, ordered by capture, method and seed.

    Raises:
        InputError: No capture, a method is unknown, or something is named twice.
    """
    if not arguments.captures:
        raise InputError("expected at least one capture folder, found none; pass folders written by ggavatar-prep")
    for name, values in (("--methods", arguments.methods), ("--seeds", arguments.seeds)):
        if not values or len(set(values)) != len(values):
            raise InputError(f"{name}: expected different values, found {' '.join(map(str, values)) or 'none'}")
    for method in arguments.methods:
        registry.check_name(method)
    output = arguments.output.resolve()  # cells may be trained in other working directories
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
    """Flags for every ggavatar-train.

    Raises:
        InputError: --steps and --minutes are both given, or --minutes is not a positive time.
    """
    minutes = arguments.minutes
    if minutes is not None and arguments.steps is not None:
        raise InputError("expected --steps or --minutes, found both; leave one out")
    if minutes is not None and not (math.isfinite(minutes) and minutes > 0):
        raise InputError(f"expected --minutes above 0, found {minutes:g}; pass the wall time of one training")
    flags: list[str] = []
    for name in PASSED_ON:
        value = getattr(arguments, name)
        if value is not None:
            flags += ["--" + name.replace("_", "-"), str(value)]
    for assignment in arguments.set:
        flags += ["--set", assignment]
    return flags


def cores_per_cell(arguments: Arguments) -> int | None:
    """Cores of every cell, so that cells trained at the same time do not compete; None if there is one at a time."""
    if arguments.backend == "ray":
        return max(int(arguments.cpus_per_job), 1)
    return None if arguments.jobs == 1 else max((os.cpu_count() or 1) // arguments.jobs, 1)


def _evaluate(runs: Sequence[Path], arguments: Arguments) -> int:
    """Write the table of all trained cells with ggavatar-eval; returns its exit code."""
    layout = ["--layout", "ablation"] if len(arguments.captures) == 1 and len(arguments.methods) > 1 else []
    folder = str(arguments.output / "table")
    command = [find_console_script("ggavatar-eval"), *map(str, runs), "--table", "-o", folder, *layout]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
