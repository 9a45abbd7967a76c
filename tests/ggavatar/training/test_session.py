"""Sessions lose and mix nothing: two writers, stops before the first step, removed folders, changed captures, typos.

Also covers `ggavatar/training/same_capture.py`.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from ggavatar.cli.run import run_command
from ggavatar.cli.train import Arguments
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.training import session, trainer
from ggavatar.training.run_folder import read_config
from ggavatar.training.session import train_run

OPTIONS: dict[str, Any] = {"steps": 6, "eval_every": 0, "save_every": 2, "device": "cpu"}
PLAIN: dict[str, Any] = {**OPTIONS, "set": ["perceptual_weight=0"]}


@pytest.fixture
def capture(toy_capture: Capture, tmp_path: Path) -> Path:
    """A copy of the toy capture that a test may change."""
    shutil.copytree(toy_capture.folder, tmp_path / "capture")
    return tmp_path / "capture"


def stop_after(steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the next training die after some steps, as by `kill -9` between two of them."""
    plain, done = trainer.Trainer._step, []

    def step(self: Any, *arguments: Any) -> Any:
        done.append(1)
        if len(done) > steps:
            raise ProcessLookupError("killed")
        return plain(self, *arguments)

    monkeypatch.setattr(trainer.Trainer, "_step", step)


def test_a_second_writer_is_refused_by_name(capture: Path, tmp_path: Path) -> None:
    """The first is a process that trains for long; the second must not touch its folder."""
    run = tmp_path / "run"
    code = (
        "from pathlib import Path; from ggavatar.training.session import train_run; "
        f"train_run(Path({str(capture)!r}), Path({str(run)!r}), {{**{PLAIN!r}, 'steps': 100000}}, quiet=True)"
    )
    first = subprocess.Popen([sys.executable, "-c", code])
    try:
        deadline = time.monotonic() + 120
        while not (run / "metrics" / "train.jsonl").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        for wish in ({}, {"overwrite": True}, {"resume": True}):
            options = {"resume": True} if "resume" in wish else {**PLAIN, **wish}
            expected = rf"process {first.pid} on .* is writing" + ("|already holds a run" if not wish else "")
            with pytest.raises(InputError, match=expected):
                train_run(capture, run, options, quiet=True)
        assert read_config(run).training.steps == 100_000
    finally:
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
    assert train_run(capture, run, {**PLAIN, "overwrite": True}, quiet=True) == 6, "a killed process holds no lock"


@pytest.mark.parametrize("flag", ["", "overwrite", "resume"])
@pytest.mark.parametrize("left", ["folders", "split", "partial"])
def test_a_start_that_was_killed_early_blocks_nothing(capture: Path, tmp_path: Path, flag: str, left: str) -> None:
    run = tmp_path / "run"
    (run / "checkpoints").mkdir(parents=True)
    if left == "split":
        (run / "split.json").write_text("{}")
    if left == "partial":
        (run / ".abc.json.part").write_text("{")
    assert train_run(capture, run, {**PLAIN, **({flag: True} if flag else {})}, quiet=True) == 6
    assert not list(run.rglob("*.part"))


@pytest.mark.parametrize("flag", ["", "overwrite", "resume"])
def test_a_kill_before_the_first_checkpoint_blocks_nothing(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flag: str
) -> None:
    """The very same command goes on; once there is a checkpoint, only --resume and --overwrite do."""
    run, options = tmp_path / "run", {**PLAIN, "method": "ggavatar"}
    with monkeypatch.context() as patch:
        stop_after(1, patch)
        with pytest.raises(ProcessLookupError):
            train_run(capture, run, options, quiet=True)
    assert (run / "config.json").exists() and not list(run.glob("checkpoints/*.json"))
    assert train_run(capture, run, {**options, **({flag: True} if flag else {})}, quiet=True) == 6
    journal = (run / "metrics" / "train.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in journal] == [6]
    with pytest.raises(InputError, match="already holds a run; pass --resume"):
        train_run(capture, run, options, quiet=True)
    assert train_run(capture, run, {**options, "resume": True}, quiet=True) == 6


def test_results_without_a_checkpoint_are_kept(capture: Path, tmp_path: Path) -> None:
    """Somebody removed the checkpoints of an evaluated run to save space."""
    run = tmp_path / "run"
    train_run(capture, run, PLAIN, quiet=True)
    shutil.rmtree(run / "checkpoints")
    (run / "eval").mkdir()
    with pytest.raises(InputError, match="already holds a run"):
        train_run(capture, run, PLAIN, quiet=True)


def test_resume_takes_the_same_settings_and_refuses_others(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, options = (
        tmp_path / "run",
        {**PLAIN, "set": ["perceptual_weight=0", "latent=16", "perceptual_features=random"]},
    )
    with monkeypatch.context() as patch:
        stop_after(3, patch)
        with pytest.raises(ProcessLookupError):
            train_run(capture, run, options, quiet=True)
    for texts, words in (
        (["latent=8"], "latent = 16, found --set latent=8; omit the flag"),
        (["latnet=16"], "did you mean latent"),
    ):
        with pytest.raises(InputError, match=words):
            train_run(capture, run, {**options, "set": texts, "resume": True}, quiet=True)
    again = {**options, "set": ["latent=16", "perceptual_weight=0.0", "perceptual_features=best"], "resume": True}
    assert train_run(capture, run, again, quiet=True) == 6
    assert read_config(run).method_config["perceptual_features"] == "random"


def test_resume_of_nothing_is_a_typo(capture: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("nowhere", "empty"):
        with pytest.raises(InputError, match="--resume found no run"):
            train_run(capture, tmp_path / name, {**PLAIN, "resume": True}, quiet=True)
    assert not (tmp_path / "nowhere").exists() and not list((tmp_path / "empty").iterdir())


def test_a_removed_run_folder_does_not_come_back(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    run, plain = tmp_path / "run", trainer.Trainer._step

    def step(self: Any, number: int, *arguments: Any) -> Any:
        if number == 4:
            shutil.rmtree(run)
        return plain(self, number, *arguments)

    monkeypatch.setattr(trainer.Trainer, "_step", step)
    assert run_command(lambda: train_run(capture, run, PLAIN, quiet=True) and 0) == 1
    assert "removed or renamed" in capfd.readouterr().err and not run.exists()


def test_a_changed_capture_is_noticed_on_resume(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as killed, pytest.raises(ProcessLookupError):
        stop_after(3, killed)
        train_run(capture, tmp_path / "run", PLAIN, quiet=True)
    image = next((capture / "images").glob("*.png"))
    content = image.read_bytes()
    image.write_bytes(next((capture / "masks").glob("*.png")).read_bytes())
    with pytest.raises(InputError, match="has changed since the training began"):
        train_run(capture, tmp_path / "run", {"resume": True}, quiet=True)
    image.write_bytes(content)
    assert train_run(capture, tmp_path / "run", {"resume": True}, quiet=True) == 6


def test_a_run_that_was_copied_with_its_capture_resumes(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as killed, pytest.raises(ProcessLookupError):
        stop_after(3, killed)
        train_run(capture, tmp_path / "run", PLAIN, quiet=True)
    for name in ("capture", "run"):
        shutil.copytree(tmp_path / name, tmp_path / "elsewhere" / name)
    moved = tmp_path / "elsewhere"
    assert train_run(moved / "capture", moved / "run", {"resume": True}, quiet=True) == 6
    (moved / "capture" / "capture.json").write_text(
        (moved / "capture" / "capture.json").read_text().replace('"fps": ', '"fps": 1')
    )
    with pytest.raises(InputError, match=r"not on .*which has other contents"):
        train_run(moved / "capture", tmp_path / "run", {"resume": True}, quiet=True)


def test_a_run_and_a_capture_that_were_moved_apart_resume(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The capture is at none of the places that the run knows, but the user names it, and it is the same."""
    with monkeypatch.context() as killed, pytest.raises(ProcessLookupError):
        stop_after(3, killed)
        train_run(capture, tmp_path / "run", PLAIN, quiet=True)
    (tmp_path / "a" / "b").mkdir(parents=True)
    moved, run = capture.rename(tmp_path / "a" / "renamed"), (tmp_path / "run").rename(tmp_path / "a" / "b" / "run")
    assert train_run(moved, run, {"resume": True}, quiet=True) == 6


def test_another_run_under_the_same_name_is_not_written_into(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody moves the folder away and begins anew while the first training still runs."""
    run, plain = tmp_path / "run", trainer.Trainer._step

    def step(self: Any, number: int, *arguments: Any) -> Any:
        if number == 4:
            run.rename(tmp_path / "moved")
            (run / "checkpoints").mkdir(parents=True)
        return plain(self, number, *arguments)

    monkeypatch.setattr(trainer.Trainer, "_step", step)
    with pytest.raises(FileNotFoundError, match="removed or renamed"):
        train_run(capture, run, PLAIN, quiet=True)
    assert not list((run / "checkpoints").iterdir())


def test_a_damaged_newest_checkpoint_is_said_and_the_one_before_is_used(
    capture: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    train_run(capture, run, PLAIN, quiet=True)
    path = run / "checkpoints" / "step-000000006.json"
    stored = json.loads(path.read_text())
    stored["record"]["seconds"] += 1
    path.write_text(json.dumps(stored))
    assert train_run(capture, run, {"resume": True}, quiet=True) == 6
    assert "step-000000006.safetensors: damaged; the checkpoint of step 4 is used" in capfd.readouterr().err


def test_out_of_gpu_memory_is_one_message(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    import torch

    def full(*_: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nmore words")

    monkeypatch.setattr(session, "make_trainer", full)
    assert run_command(lambda: train_run(capture, tmp_path / "run", PLAIN, quiet=True), Arguments) == 1
    error = capfd.readouterr().err
    assert (
        error.startswith("out of memory: CUDA out of memory.") and "--max-gaussians" in error and error.count("\n") == 1
    )
