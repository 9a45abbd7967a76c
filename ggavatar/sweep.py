"""ggavatar-sweep: train a grid of captures, methods and seeds, then measure it into one table.

Every cell is a run folder of its own, trained by ggavatar-train in a process of its own. What is finished is skipped,
what was broken off goes on, and a cell that fails does not stop the others.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional, UseAppendAction, arg

from ggavatar import registry
from ggavatar.errors import EXIT_FAILURE, EXIT_INTERRUPTED, InputError, run_command
from ggavatar.settings import nearest


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
    jobs: int = 1
    """Cells trained at the same time."""
    preset: str | None = None
    """Passed to ggavatar-train, as the next five."""
    steps: int | None = None
    """Length of every training."""
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


@dataclass(frozen=True)
class Cell:
    """One training of the grid."""

    capture: Path
    method: str
    seed: int
    folder: Path

    @property
    def is_finished(self) -> bool:
        """Whether its run has been trained to the end."""
        try:
            return bool(json.loads((self.folder / "provenance.json").read_text())["finished"])
        except (OSError, ValueError, KeyError):
            return False

    def command(self, flags: Sequence[str]) -> list[str]:
        """The ggavatar-train that trains it or goes on with it."""
        base = [console_script("ggavatar-train"), str(self.capture.resolve()), self.method, "-o", str(self.folder)]
        if (self.folder / "config.json").exists():
            return [*base, "--resume"]
        return [*base, "--seed", str(self.seed), *flags]


def main() -> int:
    """Entry point of ggavatar-sweep."""
    arguments = tyro.cli(Arguments, prog="ggavatar-sweep")
    return run_command(lambda: sweep(arguments))


def sweep(arguments: Arguments) -> int:
    """Train what is missing, report what failed, and print the table; the exit code."""
    cells = grid(arguments)
    flags = _flags(arguments)
    with ThreadPoolExecutor(max(arguments.jobs, 1)) as pool:
        codes = list(pool.map(lambda cell: _train(cell, flags), cells))
    if EXIT_INTERRUPTED in codes:
        return EXIT_INTERRUPTED
    failed = [(cell, code) for cell, code in zip(cells, codes, strict=True) if code]
    for cell, code in failed:
        sys.stderr.write(f"failed with exit code {code}: {cell.folder}; its words are in {_log(cell)}\n")
    trained = [cell.folder for cell in cells if cell.is_finished]
    sys.stdout.write(f"{len(trained)} of {len(cells)} cells trained in {arguments.output}\n")
    sys.stdout.flush()
    measured = _measure(trained, arguments) if trained and not arguments.train_only else 0
    return EXIT_FAILURE if failed else measured


def grid(arguments: Arguments) -> list[Cell]:
    """All cells, captures first; `InputError` for an unknown method or two captures of one name."""
    known = registry.names()
    for method in arguments.methods:
        if method not in known:
            raise InputError(f"unknown method {method!r}{nearest(method, known)}; known are {', '.join(known)}")
    names = [capture.resolve().name for capture in arguments.captures]
    if len(set(names)) != len(names):
        raise InputError(f"expected captures with different folder names, found {', '.join(names)}")
    return [
        Cell(capture, method, seed, arguments.output / name / method / f"seed-{seed}")
        for capture, name in zip(arguments.captures, names, strict=True)
        for method in arguments.methods
        for seed in arguments.seeds
    ]


def _flags(arguments: Arguments) -> list[str]:
    """Flags for every ggavatar-train."""
    flags: list[str] = []
    for name in ("preset", "steps", "split", "device", "max_gaussians"):
        value = getattr(arguments, name)
        if value is not None:
            flags += ["--" + name.replace("_", "-"), str(value)]
    for assignment in arguments.set:
        flags += ["--set", assignment]
    return flags


def _train(cell: Cell, flags: Sequence[str]) -> int:
    """Train a cell unless it is finished; its output goes to a log beside its folder."""
    if cell.is_finished:
        sys.stdout.write(f"finished before: {cell.folder}\n")
        return 0
    sys.stdout.write(f"training {cell.folder}\n")
    sys.stdout.flush()
    _log(cell).parent.mkdir(parents=True, exist_ok=True)
    with _log(cell).open("a") as log:
        return subprocess.run(cell.command(flags), stdout=log, stderr=subprocess.STDOUT, check=False).returncode


def console_script(name: str) -> str:
    """One of our commands, as installed beside this Python."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        raise InputError(
            f"expected the command {name} beside {sys.executable}; install the project with pip install -e ."
        )
    return found


def _log(cell: Cell) -> Path:
    return cell.folder.with_suffix(".log")


def _measure(runs: Sequence[Path], arguments: Arguments) -> int:
    """The table over all trained cells, by ggavatar-eval."""
    layout = ["--layout", "ablation"] if len(arguments.captures) == 1 and len(arguments.methods) > 1 else []
    folder = str(arguments.output / "table")
    command = [console_script("ggavatar-eval"), *map(str, runs), "--table", "-o", folder, *layout]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
