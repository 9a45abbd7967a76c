"""One cell of a sweep: a training by ggavatar-train in a process of its own."""

from __future__ import annotations

import dataclasses
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json
from ggavatar.sweeps.backends import run_logged
from ggavatar.sweeps.time_budget import fitting_steps


@dataclass(frozen=True)
class Cell:
    """One training of the grid.

    Attributes:
        capture: The capture folder.
        method: Name of the method or variant.
        seed: Seed of all random numbers.
        folder: Its run folder.
    """

    capture: Path
    method: str
    seed: int
    folder: Path

    @property
    def has_begun(self) -> bool:
        """Whether its run folder exists and can be resumed; the number of steps is fixed then."""
        return (self.folder / "config.json").exists()

    @property
    def is_finished(self) -> bool:
        """Whether its run has been trained to the end."""
        try:
            return bool(read_json(self.folder / "provenance.json").get("finished", False))
        except (InputError, OSError):
            return False

    @property
    def log(self) -> Path:
        """The file with the output of its training."""
        return self.folder.with_suffix(".log")

    def command(self, flags: Sequence[str]) -> list[str]:
        """The ggavatar-train command that trains or resumes it."""
        program = find_console_script("ggavatar-train")
        base = [program, str(self.capture.resolve()), self.method, "-o", str(self.folder)]
        if self.has_begun:
            return [*base, "--resume"]
        return [*base, "--seed", str(self.seed), *flags]

    @property
    def pilot(self) -> Cell:
        """The short training that measures how long a step takes: the same cell in a sibling folder."""
        return dataclasses.replace(self, folder=self.folder.with_name(self.folder.name + "-pilot"))


def train_cell(
    cell: Cell,
    flags: tuple[str, ...],
    minutes: float | None = None,
    cores: int | None = None,
    gpu: str | None = None,
) -> int:
    """Train or resume a cell in a process of its own, log its output beside its folder, and return the exit code.

    Args:
        cell: The cell.
        flags: For ggavatar-train.
        minutes: Wall time that determines the number of steps of a new cell, after a pilot on this machine.
        cores: As for `run_logged`.
        gpu: As for `run_logged`.
    """
    if minutes is not None and not cell.has_begun:
        pilot = cell.pilot
        result = fitting_steps(
            minutes, pilot.folder, lambda more: run_logged(pilot.command((*flags, *more)), cell.log, cores, gpu)
        )
        if result.code:
            return result.code
        flags = (*flags, "--steps", str(result.steps))
    return run_logged(cell.command(flags), cell.log, cores, gpu)


def find_console_script(name: str) -> str:
    """Path of one of our commands, as installed beside this Python interpreter or on the PATH."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        raise InputError(
            f"expected the command {name} beside {sys.executable}, found none; install the project with "
            "pip install -e ."
        )
    return found
