"""Equal wall time for the cells of a sweep: a short pilot training measures how many steps fit.

Every schedule scales with the number of steps, so that a pilot passes through each resolution and stage in proportion,
and its mean time per step is that of a training of any length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.training.journal import read_journal

PILOT_STEPS = 100
"""Number of steps of a pilot; the first logged tenth of them includes the start-up."""


@dataclass(frozen=True)
class LoggedTime:
    """The training time after a number of steps, as a line of the training journal holds it.

    Attributes:
        step: Steps done.
        seconds: Training time, s.
    """

    step: int
    seconds: float


@dataclass(frozen=True)
class PilotResult:
    """The result of a pilot.

    Attributes:
        code: Its exit code.
        steps: How many steps fit into the wall time, if the exit code is 0.
    """

    code: int
    steps: int = 0


def fitting_steps(minutes: float, pilot: Path, train: Callable[[Sequence[str]], int]) -> PilotResult:
    """Train a pilot, compute how many steps fit, and remove the pilot's run.

    Args:
        minutes: Wall time of the training, without start-up, evaluations on test frames and the pilot.
        pilot: Folder for the pilot; the run that an earlier attempt left there is removed.
        train: Trains into that folder with these additional flags and returns the exit code.

    Raises:
        InputError: The pilot has logged too few times.
    """
    from ggavatar.training.run_folder import remove_run  # torch, which --help does without

    remove_run(pilot)
    try:
        code = train(("--steps", str(PILOT_STEPS), "--eval-every", "0"))
        return PilotResult(code) if code else PilotResult(0, steps_within(minutes, seconds_per_step(read_times(pilot))))
    finally:
        remove_run(pilot)


def read_times(run: Path) -> list[LoggedTime]:
    """The times that a run has logged, in order; empty if it has logged nothing."""
    path = run / "metrics" / "train.jsonl"
    try:
        return [LoggedTime(line["step"], line["seconds"]) for line in read_journal(path)]
    except KeyError as error:
        raise InputError(
            f"{path}: expected lines with step and seconds, found one without {error}; train again"
        ) from error


def seconds_per_step(times: Sequence[LoggedTime]) -> float:
    """Mean time of a step, s; the first logged part, which includes compilation, is assumed as fast as the second."""
    if len(times) < 2 or times[-1].seconds <= times[0].seconds:
        raise InputError(
            f"expected a pilot that logs its time at least twice, found {len(times)} entries; "
            "set the number of steps with --steps instead of --minutes"
        )
    first, second, last = times[0], times[1], times[-1]
    beginning = first.step * (second.seconds - first.seconds) / (second.step - first.step)
    return (beginning + last.seconds - first.seconds) / last.step


def steps_within(minutes: float, seconds: float) -> int:
    """How many steps of `seconds` s fit into `minutes` min; at least one."""
    return max(math.floor(60 * minutes / seconds), 1)
