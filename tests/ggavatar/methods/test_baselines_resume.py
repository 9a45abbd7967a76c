"""Baselines that go on: two runs, and one that was broken off amid changes of its rows, end bit for bit alike."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.training.checkpoint import load_checkpoint
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import StopSignals, Trainer

SETTINGS = ["density_start=0", "density_gradient=1e-6"]
OWN_SETTINGS = {"ps_avatar": ["stage_share=0.5", "first_opacity=0.101", "first_places=surface", "least_share=0.8"]}
"""PSAvatar has no density control: its points are pruned in step 20, in which they become Gaussians."""


def start(capture: Capture, folder: Path, method: str) -> Trainer:
    """A trainer that adds and removes rows every 10 of 40 steps."""
    options = {"method": method, "steps": 40, "eval_every": 0, "max_gaussians": 400, "device": "cpu"}
    options["set"] = OWN_SETTINGS.get(method, SETTINGS)
    config, split = configure(capture, options)
    plan = dataclasses.replace(config.training, resolutions=(), save_every=1_000)
    return make_trainer(folder, dataclasses.replace(config, training=plan), capture, split)


def state(folder: Path) -> dict[str, torch.Tensor]:
    return load_checkpoint(folder / "checkpoints")[0]


class StopAt:
    """A listener that asks to stop after a step."""

    def __init__(self, stop: StopSignals, step: int) -> None:
        self._stop, self._step = stop, step

    def step(self, step: int, loss: float, gaussians: int) -> None:
        self._stop.received = 15 if step == self._step else self._stop.received

    def evaluated(self, step: int, psnr: float) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.mark.parametrize("method", ["gaussian_avatars", "gaussian_blendshapes", "ps_avatar", "splatting_avatar"])
def test_interrupted_run_equals_one_without(method: str, toy_capture: Capture, tmp_path: Path) -> None:
    for name in ("straight", "broken"):
        (tmp_path / name).mkdir()
    start(toy_capture, tmp_path / "straight", method).run(0, StopSignals())
    for step in (13, 1_000):
        trainer, stop = start(toy_capture, tmp_path / "broken", method), StopSignals()
        trainer.listener = StopAt(stop, step)
        assert trainer.run(trainer.resume(), stop) == min(step, 40)
    one, other = state(tmp_path / "straight"), state(tmp_path / "broken")
    assert one.keys() == other.keys() and len(one["avatar.rows.carried.face"]) > 300
    assert all(torch.equal(one[name], other[name]) for name in one)
