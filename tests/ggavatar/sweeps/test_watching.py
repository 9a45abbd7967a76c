"""Which cells run, and their steps, from the files that trainings write.

Also covers `ggavatar/cli/cell_progress.py`.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from ggavatar.cli import cell_progress
from ggavatar.cli.cell_progress import show_cells
from ggavatar.sweeps.cell import Cell
from ggavatar.sweeps.watching import CellWatch, short_name, step_of


def make_cell(folder: Path, seed: int) -> Cell:
    return Cell(folder / "alice", "ggavatar", seed, folder / "sweep" / "alice" / "ggavatar" / f"seed-{seed}")


def write_step(run: Path, step: int, total: int = 6000) -> None:
    """What a training writes that has reached a step, with a line that is not whole yet."""
    (run / "metrics").mkdir(parents=True, exist_ok=True)
    (run / "config.json").write_text(json.dumps({"training": {"steps": total}}))
    (run / "metrics" / "train.jsonl").write_text(f'{{"step": {step - 10}}}\n{{"step": {step}}}\n{{"ste')


def begin(cell: Cell, text: str = "begins\n") -> None:
    """What a process does first that trains a cell."""
    cell.log.parent.mkdir(parents=True, exist_ok=True)
    with cell.log.open("a") as log:
        log.write(text)


def test_cells_run_from_their_first_output_to_their_end(tmp_path: Path) -> None:
    first, second = make_cell(tmp_path, 1), make_cell(tmp_path, 2)
    begin(second, "an earlier sweep\n")
    watch = CellWatch([first, second])
    assert watch.running() == [] and watch.describe() == ""
    begin(first)
    begin(second)
    assert watch.begun() == [first, second] and watch.begun() == []
    assert watch.describe() == "alice/ggavatar/seed-1 starting, alice/ggavatar/seed-2 starting"
    watch.done.add(first.folder)
    write_step(second.folder, 400)
    assert watch.describe() == "alice/ggavatar/seed-2 step 400/6000"


def test_a_pilot_is_told_apart(tmp_path: Path) -> None:
    cell = make_cell(tmp_path, 1)
    write_step(cell.pilot.folder, 50, 100)
    assert step_of(cell) == "pilot, step 50/100"


def test_damaged_files_are_a_start(tmp_path: Path) -> None:
    cell = make_cell(tmp_path, 1)
    write_step(cell.folder, 10)
    for text in ("", "\n", "[]\n", "{}\n", "no JSON\n"):
        (cell.folder / "metrics" / "train.jsonl").write_text(text)
        assert step_of(cell) == "starting"


def test_a_sweep_shows_its_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cell_progress, "TICK", 0.01)
    monkeypatch.setattr("ggavatar.text.clocked_lines.INTERVAL", 0.02)
    cell = make_cell(tmp_path, 7)
    shown = ""
    with show_cells([cell]):
        begin(cell)
        write_step(cell.folder, 30)
        for _ in range(500):
            shown += capsys.readouterr().err
            if "step 30/6000" in shown:
                break
            time.sleep(0.01)
    assert shown.startswith(f"training {short_name(cell)} (its output: {cell.log})\n")
    assert "alice/ggavatar/seed-7 step 30/6000\n" in shown
