"""Training schedules: scaling of a paper's iteration constants to the number of steps, and learning-rate decay."""

from __future__ import annotations

import math

PAPER_STEPS = 120_000
"""Iterations of the training that the paper's constants refer to (GGAvatar, Sec. 3.5)."""


def scaled(iteration: int, steps: int, length: int = PAPER_STEPS) -> int:
    """The step of a training of `steps` that corresponds to `iteration` in a training of `length`, the paper's."""
    return round(iteration * steps / length)


def log_linear(step: int, first: float, last: float, steps: int) -> float:
    """A rate that decays exponentially from `first` at step 0 to `last` at `steps` and then stays constant (3DGS)."""
    progress = min(max(step / max(steps, 1), 0.0), 1.0)
    return math.exp((1 - progress) * math.log(first) + progress * math.log(last))
