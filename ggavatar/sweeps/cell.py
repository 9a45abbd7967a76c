"""One training of a sweep, in a process of its own."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.sweeps.backends import logged
from ggavatar.sweeps.time_budget import fitting_steps


@dataclass(frozen=True)
class Cell:
    """One training of the grid."""

    capture: Path
    method: str
    seed: int
    folder: Path

    @property
    def has_begun(self) -> bool:
        """Whether its run is there to go on with; its length is settled then."""
        return (self.folder / "config.json").exists()

    @property
    def is_finished(self) -> bool:
        """Whether its run has been trained to the end."""
        try:
            return bool(json.loads((self.folder / "provenance.json").read_text())["finished"])
        except (OSError, ValueError, KeyError):
            return False

    @property
    def log(self) -> Path:
        """What its training says."""
        return self.folder.with_suffix(".log")

    def command(self, flags: Sequence[str]) -> list[str]:
        """The ggavatar-train that trains it or goes on with it."""
        base = [console_script("ggavatar-train"), str(self.capture.resolve()), self.method, "-o", str(self.folder)]
        if self.has_begun:
            return [*base, "--resume"]
        return [*base, "--seed", str(self.seed), *flags]

    @property
    def pilot(self) -> Cell:
        """The short training that tells how long a step takes: the same in a folder beside."""
        return dataclasses.replace(self, folder=self.folder.with_name(self.folder.name + "-pilot"))


def train_cell(cell: Cell, flags: tuple[str, ...], minutes: float | None = None, cores: int | None = None) -> int:
    """Train a cell, or go on with it, in a process of its own; its output goes to a log beside its folder.

    Args:
        cell: Which.
        flags: For ggavatar-train.
        minutes: Wall time that sets the length of a cell that has not begun, after a pilot on this same machine.
        cores: As of `logged`.
    """
    if minutes is not None and not cell.has_begun:
        pilot = cell.pilot
        found = fitting_steps(
            minutes, pilot.folder, lambda more: logged(pilot.command((*flags, *more)), cell.log, cores)
        )
        if found.code:
            return found.code
        flags = (*flags, "--steps", str(found.steps))
    return logged(cell.command(flags), cell.log, cores)


def console_script(name: str) -> str:
    """One of our commands, as installed beside this Python."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        raise InputError(
            f"expected the command {name} beside {sys.executable}; install the project with pip install -e ."
        )
    return found
