"""Sweeps of equal wall time: the steps that a pilot finds to fit; a cell has one pilot and keeps its length."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from ggavatar.cli import sweep
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.sweeps import cell as cells
from ggavatar.sweeps.time_budget import PILOT_STEPS, LoggedTime, fitting_steps, seconds_per_step, steps_within

STUB = """#!{python}
import json, pathlib, sys
words = sys.argv[1:]
folder = pathlib.Path(words[words.index("-o") + 1])
with (pathlib.Path(__file__).parent / "calls").open("a") as calls:
    calls.write(json.dumps(words) + "\\n")
if "--resume" not in words:
    steps = int(words[words.index("--steps") + 1])
    (folder / "metrics").mkdir(parents=True)
    (folder / "config.json").write_text("{{}}")
    lines = [json.dumps({{"step": s, "seconds": 30 + 0.5 * s}}) for s in range(10, steps + 1, 10)]
    (folder / "metrics" / "train.jsonl").write_text("\\n".join(lines))
sys.exit({code} if not folder.name.endswith("-pilot") else {pilot_code})
"""


def stub(folder: Path, monkeypatch: pytest.MonkeyPatch, code: int = 0, pilot_code: int = 0) -> Path:
    """A ggavatar-train that logs 0.5 s per step after 30 s of start-up; returns the list of its calls."""
    script = folder / "ggavatar-train"
    script.write_text(STUB.format(python=sys.executable, code=code, pilot_code=pilot_code))
    script.chmod(0o755)
    monkeypatch.setattr(cells, "find_console_script", lambda name: str(folder / name))
    return folder / "calls"


def calls(listed: Path) -> list[list[str]]:
    return [json.loads(line) for line in listed.read_text().splitlines()]


def cell(folder: Path) -> cells.Cell:
    return cells.Cell(folder, "ggavatar", 7, folder / "grid" / "seed-7")


def test_start_up_is_left_out_and_slow_stages_count_in_proportion() -> None:
    """50 s of start-up; half the steps take 1 s and half 3 s."""
    times = [LoggedTime(step, 50.0 + step + 2 * max(step - 50, 0)) for step in range(10, 101, 10)]
    assert seconds_per_step(times) == pytest.approx(2.0)
    assert steps_within(5.0, 2.0) == 150 and steps_within(0.01, 2.0) == 1


@pytest.mark.parametrize("times", [[], [LoggedTime(10, 1.0)], [LoggedTime(10, 1.0), LoggedTime(20, 1.0)]])
def test_a_pilot_without_times_is_refused(times: list[LoggedTime]) -> None:
    with pytest.raises(InputError, match="--steps"):
        seconds_per_step(times)


def test_pilot_sets_the_length_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed, ours = stub(tmp_path, monkeypatch, code=1), cell(tmp_path)
    assert cells.train_cell(ours, ("--preset", "fast"), 2.0) == 1
    pilot, training = calls(listed)
    assert pilot[3].endswith("seed-7-pilot") and "--preset" in pilot and "7" in pilot
    assert pilot[pilot.index("--steps") + 1] == str(PILOT_STEPS)
    assert training[training.index("--steps") + 1] == "240", "two minutes of half seconds"
    assert not ours.pilot.folder.exists()
    cells.train_cell(ours, ("--preset", "fast"), 2.0)
    assert len(calls(listed)) == 3 and "--resume" in calls(listed)[2], "what has begun has no second pilot"


def test_a_pilot_that_fails_is_the_cells_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed, ours = stub(tmp_path, monkeypatch, pilot_code=130), cell(tmp_path)
    os.makedirs(ours.pilot.folder)
    assert cells.train_cell(ours, (), 2.0) == 130
    assert len(calls(listed)) == 1 and not ours.pilot.folder.exists() and not ours.folder.exists()


@pytest.mark.parametrize("wrong", [{"steps": 3, "minutes": 1.0}, {"minutes": 0.0}, {"minutes": float("nan")}])
def test_one_length_that_time_can_be(tmp_path: Path, wrong: dict[str, float]) -> None:
    (tmp_path / "capture").mkdir()
    with pytest.raises(InputError, match="--minutes"):
        sweep.sweep(sweep.Arguments((tmp_path / "capture",), tmp_path / "grid", **wrong))  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_real_cell_trains_as_long_as_its_pilot_says(toy_capture: Capture, tmp_path: Path) -> None:
    grid = tmp_path / "grid"
    arguments = sweep.Arguments((toy_capture.folder,), grid, seeds=(7,), minutes=0.02, device="cpu", train_only=True)
    assert sweep.sweep(arguments) == 0
    (config,) = [json.loads(path.read_text()) for path in grid.rglob("config.json")]
    (provenance,) = [json.loads(path.read_text()) for path in grid.rglob("provenance.json")]
    assert provenance["argv"][provenance["argv"].index("--steps") + 1] == str(config["training"]["steps"])
    assert provenance["steps"] == config["training"]["steps"] < 5000
    assert not list(grid.rglob("*-pilot"))


def test_only_the_run_in_a_pilots_folder_is_removed(tmp_path: Path) -> None:
    pilot = tmp_path / "seed-7-pilot"
    (pilot / "checkpoints").mkdir(parents=True)
    (pilot / "checkpoints" / "step-000000001.json").write_text("{}")
    (pilot / "notes.txt").write_text("years of work")
    assert fitting_steps(1.0, pilot, lambda more: 1).code == 1
    assert [path.name for path in pilot.iterdir()] == ["notes.txt"]
