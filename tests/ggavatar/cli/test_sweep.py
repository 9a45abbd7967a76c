"""The command ggavatar-sweep: the whole grid is checked before the first training, trained once, and reported.

Also covers `ggavatar/sweeps/checks.py`.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import typing
from pathlib import Path

import pytest

from ggavatar.cli import sweep, train
from ggavatar.data.capture import Capture
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.json_files import read_json, write_sealed_json
from ggavatar.losses.vgg import PerceptualLoss, random_weights
from ggavatar.pretrained.resolve import ModelUnavailable
from ggavatar.sweeps.backends import run_logged
from ggavatar.sweeps.cell import Cell
from ggavatar.training.session import train_run


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    """Run the entry point in this process; the trainings have processes of their own."""
    monkeypatch.setattr(sys, "argv", ["ggavatar-sweep", *map(str, words)])
    try:
        return sweep.main()
    except SystemExit as stop:
        return int(stop.code or 0)


@pytest.fixture
def no_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep that gets as far as training fails the test."""

    def refuse(*_: object) -> None:
        pytest.fail("a training was started")

    monkeypatch.setattr(sweep, "_train_all", refuse)


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "expected CAPTURES"),
        (["{capture}", "{missing}"], "nowhere"),
        (["{capture}", "{empty}"], "capture.json"),
        (["{capture}", "{damaged}"], "tracking.npz"),
        (["{capture}", "--methods", "flash_avatar", "gavatar"], "did you mean ggavatar?"),
        (["{capture}", "--methods", "ggavatar", "ggavatar"], "--methods: expected different values"),
        (["{capture}", "--seeds", "1", "1"], "--seeds: expected different values"),
        (["{capture}", "--preset", "pape"], "--preset"),
        (["{capture}", "--set", "latnet=3"], "did you mean latent?"),
        (["{capture}", "--methods", "ggavatar", "flash_avatar", "--set", "latent=3"], "method flash_avatar"),
        (["{capture}", "--set", "latent=many"], "expected int"),
        (["{capture}", "--steps", "0"], "--steps: expected 1 or more"),
        (["{capture}", "--max-gaussians", "0"], "--max-gaussians: expected 1 or more"),
        (["{capture}", "--split", "some"], "split 'some'"),
        (["{capture}", "--split", "last-500"], "too few"),
        (["{capture}", "--device", "tpu"], "--device"),
        (["{capture}", "--minutes", "-1"], "--minutes above 0"),
        (["{capture}", "--jobs", "0"], "--jobs"),
        (["{capture}", "{twin}"], "different folder names"),
    ],
)
def test_everything_is_checked_before_the_first_training(
    words: list[str],
    message: str,
    toy_capture: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    places = {name: tmp_path / name for name in ("empty", "damaged", "twins")}
    places["empty"].mkdir()
    shutil.copytree(toy_capture.folder, places["damaged"])
    (places["damaged"] / "tracking.npz").write_bytes(b"nothing")
    places["twin"] = places["twins"] / toy_capture.folder.name
    shutil.copytree(toy_capture.folder, places["twin"])
    places |= {"capture": toy_capture.folder, "missing": tmp_path / "nowhere"}
    out = tmp_path / "out"
    assert run(monkeypatch, *(word.format(**places) for word in words), "-o", out) == 2
    shown = capfd.readouterr().err
    assert message in shown and "Traceback" not in shown
    assert not out.exists()


@pytest.mark.usefixtures("no_training")
def test_perceptual_features_are_settled_once_before_the_first_training(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sweep of many cells neither loads the network for each nor fails in its last one."""
    asked: list[str] = []

    def load(features: str) -> PerceptualLoss:
        asked.append(features)
        if features == "vgg16":
            raise ModelUnavailable("no VGG16 here")
        return PerceptualLoss("random", random_weights(0))

    monkeypatch.setattr("ggavatar.training.session.perceptual_loss", load)
    grid = [toy_capture.folder, "--methods", "ggavatar", "flash_avatar", "gaussian_avatars", "--seeds", "1", "2"]
    with pytest.raises(pytest.fail.Exception, match="a training was started"):
        run(monkeypatch, *grid, "-o", tmp_path / "out")
    assert asked == ["best"]
    assert run(monkeypatch, *grid, "--preset", "paper", "-o", tmp_path / "out") == 2
    assert "--set perceptual_features=random" in capsys.readouterr().err and asked == ["best", "vgg16"]


@pytest.mark.usefixtures("no_training")
def test_the_output_must_not_be_a_file(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").write_text("mine")
    assert run(monkeypatch, toy_capture.folder, "-o", tmp_path / "mine") == 2
    assert "found a file" in capfd.readouterr().err and (tmp_path / "mine").read_text() == "mine"


@pytest.mark.slow
def test_the_grid_is_trained_once_and_failures_are_reported(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    grid = tmp_path / "grid"
    blocked = grid / toy_capture.folder.name / "ggavatar" / "seed-8"
    blocked.mkdir(parents=True)
    (blocked / "mine.txt").write_text("not a run")
    words = [toy_capture.folder, "-o", grid, "--seeds", 7, 8, "--steps", 4, "--device", "cpu", "--train-only"]
    assert run(monkeypatch, *words) == 1
    shown = capfd.readouterr()
    assert "1 of 2 cells trained" in shown.out and shown.err.count("failed with exit code 2") == 1
    configs = [json.loads(path.read_text()) for path in sorted(grid.rglob("config.json"))]
    assert [config["seed"] for config in configs] == [7]
    assert run(monkeypatch, *words) == 1
    assert capfd.readouterr().out.count("already finished") == 1
    words[words.index("--steps") + 1] = 6
    assert run(monkeypatch, *words) == 2
    assert "already holds a run with steps = 4, found 6" in capfd.readouterr().err
    words[words.index("--steps") + 1] = 4
    assert run(monkeypatch, *words, "--set", "latent=3") == 2
    assert "found 3; choose another folder" in capfd.readouterr().err


def test_devices_of_a_cluster_are_not_those_of_this_computer(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    arguments = sweep.Arguments((toy_capture.folder,), tmp_path, backend="ray", device="cuda", train_only=True)
    sweep.check(arguments, sweep.grid(arguments))


def test_flags_that_are_passed_on_have_the_types_of_ggavatar_train() -> None:
    ours, theirs = (typing.get_type_hints(kind) for kind in (sweep.Arguments, train.Arguments))
    assert [ours[name] for name in sweep.PASSED_ON] == [theirs[name] for name in sweep.PASSED_ON]


@pytest.mark.usefixtures("no_training")
def test_a_second_sweep_is_refused_by_name(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    words = [toy_capture.folder, "-o", tmp_path / "grid", "--device", "cpu", "--set", "perceptual_weight=0"]
    (tmp_path / "grid").mkdir()
    with lock_folder(tmp_path / "grid"):
        assert run(monkeypatch, *words) == 2
    assert f"(process {os.getpid()} on " in capfd.readouterr().err
    assert not list((tmp_path / "grid").iterdir())


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("finished", [True, False])
def test_cells_of_another_capture_are_not_counted_as_trained(
    toy_capture: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    finished: bool,
) -> None:
    """Finished or only begun: another capture of the same folder name, and the same one with other images."""
    capture, grid = tmp_path / "data" / "anna", tmp_path / "grid"
    shutil.copytree(toy_capture.folder, capture)
    cell = grid / "anna" / "ggavatar" / "seed-42"
    train_run(capture, cell, {"steps": 2, "device": "cpu", "set": ["perceptual_weight=0"]}, quiet=True)
    record = cell / "provenance.json"
    values = {**read_json(record), "finished": finished}
    write_sealed_json(record, values)
    images = sorted((capture / "images").iterdir())
    images[0].write_bytes(images[1].read_bytes())
    words = ["-o", grid, "--device", "cpu", "--set", "perceptual_weight=0"]
    assert run(monkeypatch, capture, *words) == 2
    assert "has changed since the training began" in capfd.readouterr().err
    other = tmp_path / "elsewhere" / "anna"
    shutil.copytree(capture, other)
    assert run(monkeypatch, other, *words) == 2
    assert "which has other contents" in capfd.readouterr().err


def test_a_grid_that_is_removed_meanwhile_does_not_come_back(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    grid = tmp_path / "grid"

    def removing(cell: Cell, *_: object) -> int:
        shutil.rmtree(grid, ignore_errors=True)
        return run_logged([sys.executable, "-c", ""], cell.log)

    monkeypatch.setattr(sweep, "train_cell", removing)
    words = [toy_capture.folder, "-o", grid, "--seeds", 1, 2, "--device", "cpu", "--set", "perceptual_weight=0"]
    assert run(monkeypatch, *words, "--train-only") == 1
    assert capfd.readouterr().err.count("removed or renamed") == 2 and not grid.exists()


def test_sigterm_ends_the_trainings_too(tmp_path: Path) -> None:
    """A training in a process of its own would otherwise go on for hours after its sweep."""
    code = f"""
import functools, sys
from pathlib import Path
from ggavatar.cli.run import run_command
from ggavatar.sweeps.backends import CellTraining, LocalProcesses, run_logged
place = Path({str(tmp_path)!r})
child = [sys.executable, "-c", f"import time; open({{str(place / 'child')!r}}, 'w').close(); time.sleep(600)"]
cells = [CellTraining(str(number), functools.partial(run_logged, child, place / "log")) for number in range(3)]
sys.exit(run_command(lambda: len(list(LocalProcesses(1).run(cells)))))
"""
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "child").exists():
        time.sleep(0.05)
        assert process.poll() is None
    process.terminate()
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 143 and errors.startswith("terminated")
