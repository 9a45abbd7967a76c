"""Training schedules: length, learning-rate decay, coarse-to-fine resolution, and the presets."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ggavatar.errors import InputError, nearest
from ggavatar.optim.schedules import PAPER_STEPS

PRESET_NAMES = ("default", "fast", "paper")


@dataclass(frozen=True)
class TrainingPlan:
    """The settings of the training loop, which are the same for all methods."""

    steps: int = 6_000
    """Number of steps; every schedule scales with it. 120,000 in the paper."""
    resolutions: tuple[tuple[float, float], ...] = ((0.25, 0.25), (0.25, 0.5))
    """Coarse to fine: pairs (fraction of the steps, fraction of the size), then full size. Empty in the paper."""
    smallest: int = 128
    """`resolutions` make no side smaller than this, px."""
    cooling: float = 0.4
    """Fraction of the steps, at the end, in which all learning rates decay; 0 in the paper, which mentions no decay."""
    coolest: float = 0.02
    """Factor on the learning rates in the last step."""
    eval_every: int = 1_000
    """Steps between two evaluations on test frames; 0 is never."""
    eval_frames: int = 4
    """Test frames per evaluation."""
    save_every: int = 1_000
    """Steps between two checkpoints; one is always written at the end."""
    log_every: int = 10
    """Steps between two lines in metrics/train.jsonl."""
    max_gaussians: int = 40_000
    """Largest number of Gaussians."""
    cache_mib: int = 1024
    """Memory for decoded frames, MiB."""
    bad_steps: int = 10
    """Number of steps with a loss or gradient that is not finite at which the training stops."""

    def rate_factor(self, step: int) -> float:
        """Factor on all learning rates in a step (from 1): 1, then half a cosine down to `coolest`.

        The decay damps the networks, which move all Gaussians together; at a constant rate they oscillate by half a
        pixel until the last step (docs/experiments/2026-11-22-learning-rate-decay.md).
        """
        begin = (1 - self.cooling) * self.steps
        share = (step - begin) / max(self.steps - begin, 1)
        return 1.0 if share <= 0 else self.coolest + (1 - self.coolest) * 0.5 * (1 + math.cos(math.pi * min(share, 1)))

    def size_at(self, step: int, width: int, height: int) -> tuple[int, int]:
        """Width and height to train at in a step (from 1), px, for frames of `width` × `height`."""
        passed = 0.0
        for share, size in self.resolutions:
            passed += share
            if step <= passed * self.steps:
                factor = min(max(size, self.smallest / min(width, height)), 1.0)
                return round(width * factor), round(height * factor)
        return width, height


def preset(name: str, device: str) -> TrainingPlan:
    """The settings of a preset.

    Args:
        name: `default`, for good results on the given device; `fast`, for a preview within minutes; `paper`, the
            published schedule.
        device: `cpu`, or another device, for which the default is longer.

    Raises:
        InputError: There is no such preset.
    """
    if name not in PRESET_NAMES:
        raise InputError(f"preset {name!r}: expected one of {', '.join(PRESET_NAMES)}{nearest(name, PRESET_NAMES)}")
    if name == "paper":
        return TrainingPlan(
            PAPER_STEPS,
            resolutions=(),
            cooling=0.0,
            eval_every=5_000,
            eval_frames=8,
            save_every=5_000,
            log_every=100,
            max_gaussians=1_000_000,
        )
    if device != "cpu":
        steps = 30_000 if name == "default" else 5_000
        return TrainingPlan(steps, resolutions=(), eval_frames=8, save_every=2_500, max_gaussians=200_000)
    return (
        TrainingPlan()
        if name == "default"
        else TrainingPlan(1_500, eval_every=500, save_every=500, max_gaussians=20_000)
    )
