"""Equal wall time for the cells of a sweep: a short pilot training says how many steps fit.

Every schedule scales with the length of a training, so that a pilot sees each resolution and stage in proportion and
its mean time for a step is that of a training of any length.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError

PILOT_STEPS = 100
"""Length of a pilot; its first logged part, a tenth, holds the start-up."""


@dataclass(frozen=True)
class Moment:
    """One line of a training's journal: the seconds of training after so many steps."""

    step: int
    seconds: float


@dataclass(frozen=True)
class Pilot:
    """What came of a pilot: its exit code and, if that is 0, the steps that fit."""

    code: int
    steps: int = 0


def fitting_steps(minutes: float, pilot: Path, train: Callable[[Sequence[str]], int]) -> Pilot:
    """Train a pilot and say how many steps fit; the pilot's folder is gone afterwards.

    Args:
        minutes: Wall time of the training, without start-up, looks at test frames and the pilot.
        pilot: Folder for the pilot; what an earlier attempt left there is removed.
        train: Trains into that folder with these further flags, and gives the exit code.

    Raises:
        InputError: The pilot left no times to reckon with.
    """
    shutil.rmtree(pilot, ignore_errors=True)
    try:
        code = train(("--steps", str(PILOT_STEPS), "--eval-every", "0"))
        return Pilot(code) if code else Pilot(0, steps_within(minutes, seconds_per_step(journal(pilot))))
    finally:
        shutil.rmtree(pilot, ignore_errors=True)


def journal(run: Path) -> list[Moment]:
    """The times that a run has logged, in order; none if it has logged nothing."""
    path = run / "metrics" / "train.jsonl"
    try:
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        return [Moment(line["step"], line["seconds"]) for line in lines]
    except FileNotFoundError:
        return []
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected lines with step and seconds, found {error}; train again") from error


def seconds_per_step(moments: Sequence[Moment]) -> float:
    """Mean time of a step, s; the first logged part, which holds compilation, is taken to be as fast as the second."""
    if len(moments) < 2 or moments[-1].seconds <= moments[0].seconds:
        raise InputError(
            f"expected a pilot that logs its time at least twice, found {len(moments)} entries; "
            "give the length of the trainings by --steps instead of --minutes"
        )
    first, second, last = moments[0], moments[1], moments[-1]
    beginning = first.step * (second.seconds - first.seconds) / (second.step - first.step)
    return (beginning + last.seconds - first.seconds) / last.step


def steps_within(minutes: float, seconds: float) -> int:
    """Steps of so many seconds that fit into so many minutes, at least one."""
    return max(math.floor(60 * minutes / seconds), 1)
