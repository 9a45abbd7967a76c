"""Which cells of a sweep are being trained, and at which step, as their files say: cells run in other processes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.json_files import parse_value, read_json
from ggavatar.io.regular_files import open_regular
from ggavatar.sweeps.cell import Cell

TAIL_BYTES = 4096
"""So much of the end of a journal is read."""


class CellWatch:
    """Looks at the files of cells.

    Attributes:
        done: Cells whose training has ended.
    """

    def __init__(self, cells: Sequence[Cell]) -> None:
        """Watch some cells; what is in their files already was written by an earlier sweep."""
        self._cells = tuple(cells)
        self._before = {cell.folder: _changed(cell.log) for cell in cells}
        self._announced: set[Path] = set()
        self.done: set[Path] = set()

    def running(self) -> list[Cell]:
        """The cells whose training has begun and not ended."""
        return [
            cell
            for cell in self._cells
            if cell.folder not in self.done and _changed(cell.log) != self._before[cell.folder]
        ]

    def begun(self) -> list[Cell]:
        """The cells whose training has begun since the last call."""
        fresh = [cell for cell in self.running() if cell.folder not in self._announced]
        self._announced |= {cell.folder for cell in fresh}
        return fresh

    def describe(self) -> str:
        """The running cells with their steps, in one line."""
        return ", ".join(f"{short_name(cell)} {step_of(cell)}" for cell in self.running())


def short_name(cell: Cell) -> str:
    """Capture, method and seed of a cell, as its folders are named."""
    return "/".join(cell.folder.parts[-3:])


def step_of(cell: Cell) -> str:
    """The step that a cell has reached, such as "step 400/6000"; "starting" before the first."""
    for folder in (cell.folder, cell.pilot.folder):
        with contextlib.suppress(InputError, OSError, KeyError, TypeError, ValueError, IndexError):
            total = int(read_json(folder / "config.json")["training"]["steps"])
            step = int(parse_value(_last_line(folder / "metrics" / "train.jsonl"))["step"])
            return f"{'pilot, ' if folder != cell.folder else ''}step {step}/{total}"
    return "starting"


def _last_line(path: Path) -> str:
    """The last whole line of a growing file of lines."""
    with open_regular(path) as file:
        file.seek(max(file.seek(0, os.SEEK_END) - TAIL_BYTES, 0))
        text = file.read(TAIL_BYTES)
    return text[: text.rindex(b"\n")].splitlines()[-1].decode()


def _changed(path: Path) -> tuple[int, float] | None:
    """Size and time of a file; None if it is not there."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime
