"""A short training of a method on the pretended device, counted step by step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from benchmarks.pretended.tally import Tally
from ggavatar.data.capture import Capture
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import StopSignals, Trainer

FEWER = {
    "flash_avatar": ("texels=24",),
    "point_avatar": ("fitting_steps=2", "surface_width=16", "surface_layers=2", "points=200"),
}
"""Settings that make a method small; they change no count."""


@dataclass(frozen=True)
class Counts:
    """What a step, or a frame, asked of the device.

    Attributes:
        launches: Kernels.
        syncs: How often the host waited for the device.
        places: Where it waited, and how often there.
    """

    launches: int
    syncs: int
    places: dict[str, int]

    @staticmethod
    def of(tally: Tally) -> Counts:
        """The counts since the tally was reset."""
        return Counts(tally.launches, sum(tally.syncs.values()), tally.places())


@dataclass(frozen=True)
class CountedTraining:
    """A training that has ended.

    Attributes:
        trainer: The trainer.
        steps: Counts from one step to the next, by step; reading the frame is part of a step.
    """

    trainer: Trainer
    steps: dict[int, Counts]


def make_pretended_trainer(method: str, capture: Capture, folder: Path, options: dict[str, Any]) -> Trainer:
    """A trainer on the pretended device, with features that need no download."""
    wanted = {"steps": 12, "eval_every": 0, "save_every": 10**6, "max_gaussians": 16_000, **options}
    wanted["set"] = ["perceptual_features=random", *FEWER.get(method, ()), *options.get("set", ())]
    config, split = configure(capture, {**wanted, "method": method, "device": "cuda"})
    folder.mkdir(parents=True, exist_ok=True)
    return make_trainer(folder, config, capture, split)


def train_counted(trainer: Trainer, tally: Tally, done: int = 0) -> CountedTraining:
    """Train to the end and count every step."""
    steps: dict[int, Counts] = {}
    after = trainer.listener

    class Listener:
        """Counts up to the end of every step."""

        def step(self, step: int, loss: Any, gaussians: int) -> None:
            steps[step] = Counts.of(tally)
            tally.reset()

        def evaluated(self, step: int, psnr: float) -> None:
            after.evaluated(step, psnr)

        def close(self) -> None:
            after.close()

    trainer.listener = Listener()
    tally.reset()
    with StopSignals() as stop:
        trainer.run(done, stop)
    return CountedTraining(trainer, steps)


def count_frame(trainer: Trainer, tally: Tally) -> Counts:
    """Counts of rendering a frame with what evaluation caches in place."""
    avatar, frames, number = trainer.avatar.eval(), trainer.frames, trainer.split.test[0]
    drive, camera = frames.drive(number), frames.camera(number)
    with torch.no_grad():
        for _ in range(2):
            tally.reset()
            trainer.rasterize(avatar.gaussians(drive), camera, trainer.background)
    counts = Counts.of(tally)
    avatar.train()
    return counts
