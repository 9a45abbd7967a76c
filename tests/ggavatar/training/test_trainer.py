"""Training on a toy capture: it learns, is reproducible to the bit, and so is a run resumed after any interruption.

Also covers `ggavatar/head/region_boxes.py`, `ggavatar/training/provenance.py`.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.io.json_files import write_json
from ggavatar.training import registry
from ggavatar.training.checkpoint import complete_steps, load_checkpoint
from ggavatar.training.finite_guard import FiniteGuard, TrainingError
from ggavatar.training.journal import read_journal
from ggavatar.training.run_folder import open_run, write_config
from ggavatar.training.session import TrainingInterrupted, configure, make_trainer, train_run
from ggavatar.training.trainer import StopSignals, Trainer

OPTIONS: dict[str, Any] = {"steps": 60, "eval_every": 0, "save_every": 25, "max_gaussians": 400, "device": "cpu"}
"""At this length density control works every 10 steps from step 10 to 30."""

SETTINGS = ["density_start=20000", "neutral_iterations=30000", "density_gradient=1e-5", "crop_side=32"]
"""Density from step 10, expressions from step 15, so that a short toy passes through every stage."""


def losses(folder: Path) -> list[dict[str, Any]]:
    """The training journal without its clocks."""
    return [
        {key: value for key, value in line.items() if key not in ("seconds", "waited")}
        for line in read_journal(folder / "metrics/train.jsonl")
    ]


def final_state(folder: Path) -> dict[str, torch.Tensor]:
    return load_checkpoint(folder / "checkpoints")[0]


def assert_same(one: Path, other: Path) -> None:
    """Losses and final state are equal to the last bit."""
    assert losses(one) == losses(other) and losses(one)
    first, second = final_state(one), final_state(other)
    assert first.keys() == second.keys()
    assert all(torch.equal(first[name], second[name]) for name in first)


def start(capture: Capture, folder: Path, **changes: Any) -> Trainer:
    """A trainer in a new run folder that logs every step."""
    config, split = configure(capture, {**OPTIONS, "set": SETTINGS, **changes})
    config = dataclasses.replace(config, training=dataclasses.replace(config.training, log_every=1))
    folder.mkdir(parents=True, exist_ok=True)
    write_config(folder, config, split)
    write_json(folder / "provenance.json", {})
    return make_trainer(folder, config, capture, split)


@pytest.fixture(scope="module")
def straight(toy_capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run without interruption."""
    folder = tmp_path_factory.mktemp("runs") / "straight"
    start(toy_capture, folder).run(0, StopSignals())
    return folder


def test_run_passes_through_every_stage(straight: Path, toy_capture: Capture) -> None:
    lines = losses(straight)
    assert [line["step"] for line in lines] == list(range(1, 61))
    counts = [line["gaussians"] for line in lines]
    assert counts[0] < counts[-1] <= 400
    assert "perceptual" not in {name for line in lines[:15] for name in line["terms"]}
    assert "perceptual" in {name for line in lines[15:] for name in line["terms"]}


def test_two_runs_are_bit_identical(straight: Path, toy_capture: Capture, tmp_path: Path) -> None:
    start(toy_capture, tmp_path / "again").run(0, StopSignals())
    assert_same(straight, tmp_path / "again")


def test_another_seed_differs(straight: Path, toy_capture: Capture, tmp_path: Path) -> None:
    start(toy_capture, tmp_path / "other", seed=43).run(0, StopSignals())
    assert losses(straight) != losses(tmp_path / "other")


class StopAt:
    """A listener that asks to stop after a step, as a signal would."""

    def __init__(self, stop: StopSignals, step: int) -> None:
        self._stop, self._step = stop, step

    def step(self, step: int, loss: float, gaussians: int) -> None:
        if step == self._step:
            self._stop.received = signal.SIGTERM

    def evaluated(self, step: int, psnr: float) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.mark.parametrize("steps", [(9,), (10, 20), (15, 31), (25, 26)])
def test_resume_is_bit_identical(straight: Path, toy_capture: Capture, tmp_path: Path, steps: tuple[int, ...]) -> None:
    """Interrupted right before, at and after density rounds, a change of stage and a regular checkpoint."""
    folder = tmp_path / "broken"
    for step in (*steps, 1000):
        trainer, stop = start(toy_capture, folder), StopSignals()
        trainer.listener = StopAt(stop, step)
        done = trainer.run(trainer.resume(), stop)
        assert done == min(step, 60)
    assert_same(straight, folder)


def test_kill_loses_nothing_but_time(straight: Path, toy_capture: Capture, tmp_path: Path) -> None:
    """kill -9 in the middle, with a damaged checkpoint beside; the resumed run equals the one without interruption."""
    folder = tmp_path / "killed"
    start(toy_capture, folder)
    code = (
        "import sys; from pathlib import Path; from ggavatar.training.session import train_run; "
        f"train_run(Path({str(toy_capture.folder)!r}), Path({str(folder)!r}), {{'resume': True}}, quiet=True)"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.monotonic() + 240
    while not complete_steps(folder / "checkpoints") and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert complete_steps(folder / "checkpoints")[0] in (25, 50, 60)
    (folder / "checkpoints" / "step-000000059.safetensors").write_bytes(b"torn")
    (folder / "checkpoints" / "step-000000059.json").write_text('{"step": 59, "bytes": 400, "sha256": "0"}')
    with (folder / "metrics/train.jsonl").open("a") as journal:
        journal.write('{"step": 59, "ter')
    assert train_run(toy_capture.folder, folder, {"resume": True}, quiet=True) == 60
    assert_same(straight, folder)


def mean_psnr(avatar: Any, trainer: Trainer) -> float:
    """Over the test frames."""
    values = []
    with torch.no_grad():
        for number in trainer.split.test:
            frame = trainer.frames.frame(number)
            image = trainer.rasterize(avatar.gaussians(frame.drive), frame.camera, trainer.background).image
            values.append(float(-10 * torch.log10((image.clamp(0, 1) - frame.image).square().mean())))
    return sum(values) / len(values)


METHODS = {path.stem for path in registry.METHODS_FOLDER.glob("*.py")}


@pytest.mark.parametrize(
    "name",
    [name if name in METHODS else pytest.param(name, marks=pytest.mark.slow) for name in sorted(registry.names())],
)
def test_every_method_learns_and_reopens(name: str, toy_capture: Capture, tmp_path: Path) -> None:
    """Test PSNR rises by decibels; the reopened avatar is bit-identical, also for a drive that no frame has."""
    settings = [text for text in SETTINGS if text.split("=")[0] in registry.load(name).config().__dataclass_fields__]
    trainer = start(toy_capture, tmp_path / "run", method=name, set=settings)
    before = mean_psnr(trainer.avatar.eval(), trainer)
    trainer.run(0, StopSignals())
    after = mean_psnr(trainer.avatar.eval(), trainer)
    assert after > before + 1.5

    run = open_run(tmp_path / "run")
    frame = next(iter(run.frames(run.split.test)))
    novel = dataclasses.replace(frame.drive, expression=frame.drive.expression + 0.3, frame=None)
    with torch.no_grad():
        for drive in (frame.drive, novel):
            ours, theirs = trainer.avatar.gaussians(drive), run.avatar.gaussians(drive)
            for field in ("means", "quats", "scales", "opacities", "colors"):
                assert torch.equal(getattr(ours, field), getattr(theirs, field)), field
            assert ours.sh_degree == theirs.sh_degree


def test_signal_saves_and_says_so(toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from ggavatar.training import session

    class Bomb(StopAt):
        def step(self, step: int, loss: float, gaussians: int) -> None:
            if step == 7:
                os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(session, "NullListener", lambda: Bomb(StopSignals(), 7))
    with pytest.raises(TrainingInterrupted) as stopped:
        train_run(toy_capture.folder, tmp_path / "run", OPTIONS, quiet=True)
    assert stopped.value.step == 7 and stopped.value.signal == signal.SIGINT
    assert complete_steps(tmp_path / "run" / "checkpoints") == [7]
    assert json.loads((tmp_path / "run/provenance.json").read_text())["finished"] is False


def test_finite_guard_names_the_culprit_and_gives_up() -> None:
    model, guard = torch.nn.Linear(2, 1), FiniteGuard(limit=3)
    good, bad = torch.tensor(1.0), torch.tensor(float("nan"))
    assert guard.passes(1, {"l1": good}, model)
    assert not guard.passes(2, {"l1": good, "dssim": bad}, model)
    model.weight.grad = torch.tensor([[float("inf"), 1.0]])
    assert not guard.passes(3, {"l1": good}, model)
    with pytest.raises(TrainingError, match="gradient of weight"):
        guard.passes(4, {"l1": good}, model)


def test_bad_step_changes_nothing(toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = start(toy_capture, tmp_path / "run", steps=3)
    losses_of = trainer.avatar.losses

    def poisoned(frame: Any, rendering: Any, step: int) -> dict[str, torch.Tensor]:
        terms = dict(losses_of(frame, rendering, step))
        return {**terms, "l1": terms["l1"] * float("nan")} if step == 2 else terms

    monkeypatch.setattr(trainer.avatar, "losses", poisoned)
    trainer.run(0, StopSignals())
    assert losses(tmp_path / "run")[1]["terms"]["l1"] is None
    assert all(torch.isfinite(value).all() for value in trainer.avatar.state_dict().values())


def test_existing_output_is_refused(straight: Path, toy_capture: Capture, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="already holds a run"):
        train_run(toy_capture.folder, straight, OPTIONS, quiet=True)
    for overwrite in (False, True):
        with pytest.raises(InputError, match="found other files"):
            train_run(toy_capture.folder, tmp_path, {**OPTIONS, "overwrite": overwrite}, quiet=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_overwrite_replaces_the_run_and_nothing_else(toy_capture: Capture, tmp_path: Path) -> None:
    train_run(toy_capture.folder, tmp_path / "run", {**OPTIONS, "steps": 8}, quiet=True)
    (tmp_path / "run" / "notes.txt").write_text("mine")
    train_run(toy_capture.folder, tmp_path / "run", {**OPTIONS, "steps": 5, "overwrite": True}, quiet=True)
    assert complete_steps(tmp_path / "run" / "checkpoints", limit=None) == [5]
    assert (tmp_path / "run" / "notes.txt").read_text() == "mine"


def test_harmonics_of_a_degree_that_is_not_known_are_refused(toy_capture: Capture, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sh_degree: expected 0 to 3, found 9"):
        train_run(toy_capture.folder, tmp_path / "run", {**OPTIONS, "set": ["sh_degree=9"]}, quiet=True)


def test_overwrite_spares_another_programs_configuration(toy_capture: Capture, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"model": "mine"}')
    with pytest.raises(InputError, match="expected schema"):
        train_run(toy_capture.folder, tmp_path, {**OPTIONS, "overwrite": True}, quiet=True)
    assert (tmp_path / "config.json").read_text() == '{"model": "mine"}'


def test_resume_refuses_other_settings(straight: Path, toy_capture: Capture) -> None:
    for wish in ({"seed": 7}, {"steps": 99}, {"method": "ggavatar_without_lbs"}, {"set": ["latent=3"]}):
        with pytest.raises(InputError, match="--resume continues with"):
            train_run(toy_capture.folder, straight, {"resume": True, **wish}, quiet=True)


def test_resume_of_a_finished_run_changes_nothing(toy_capture: Capture, tmp_path: Path) -> None:
    train_run(toy_capture.folder, tmp_path / "run", {**OPTIONS, "steps": 8}, quiet=True)
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    assert train_run(toy_capture.folder, tmp_path / "run", {"resume": True}, quiet=True) == 8
    assert before == {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}


def test_disk_full_ends_with_a_message_and_without_half_files(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    import errno

    from ggavatar.cli.run import run_command
    from ggavatar.training import checkpoint

    def full(path: Path, write: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    code = run_command(
        lambda: train_run(toy_capture.folder, tmp_path / "run", {**OPTIONS, "steps": 4}, quiet=True) and 0
    )
    assert code == 1 and "free some space" in capfd.readouterr().err
    assert not list((tmp_path / "run" / "checkpoints").iterdir())
