"""Iteration constants of the paper, scaled to a training's length, and learning-rate decay."""

from __future__ import annotations

import math

PAPER_STEPS = 120_000
"""Length of the training all constants of the paper refer to (Sec. 3.5)."""


def scaled(iteration: int, steps: int, length: int = PAPER_STEPS) -> int:
    """An iteration constant of a training of `length`, the paper's 120,000 or another's, in a training of `steps`."""
    return round(iteration * steps / length)


def log_linear(step: int, first: float, last: float, steps: int) -> float:
    """A rate that falls exponentially from `first` at step 0 to `last` at `steps` and stays there (3DGS)."""
    share = min(max(step / max(steps, 1), 0.0), 1.0)
    return math.exp((1 - share) * math.log(first) + share * math.log(last))
