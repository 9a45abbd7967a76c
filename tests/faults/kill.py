"""Row by row, a command is killed at random moments and run again until it is done.

The moments are spread evenly over the time that the command takes undisturbed, on as many cores. Every process of the
command gets the signal. It is then run again as a user would: with or without `--resume`, following what the message
says. In the end every file must be that of an undisturbed command, but for times and memory.
"""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.faults import tasks
from tests.faults.bench import Bench, Surroundings, kill_after
from tests.faults.case import Case, Row
from tests.faults.contents import half_written
from tests.faults.tasks import Task
from tests.faults.undisturbed import finished_wrongly, reference

EXPECTATION = "run again it ends with exit code 0 and the files of an undisturbed command, no more and no less"
EARLIER = 5
"""Times that a command which ended before it was killed is begun anew, with an earlier moment."""


def moments(row: str, seed: int) -> tuple[float, ...]:
    """When to kill the first and perhaps the second process, as fractions of the undisturbed time."""
    draw = random.Random(f"{row} {seed}")
    return tuple(draw.random() for _ in range(draw.choice((1, 1, 2))))


def kill(task: Task, bench: Bench, folder: Path, fractions: Sequence[float], seconds: float) -> list[str]:
    """Begin the task and kill it, then, if there are more moments, continue it and kill it again.

    Returns:
        What is half written after a kill.
    """
    wrong = []
    for number, fraction in enumerate(fractions):
        after = fraction * seconds
        for _ in range(EARLIER):
            flags = ("--resume",) if number and task.can_resume else ()
            arguments = (*task.arguments(bench), *flags)
            ended = bench.run(task.command, arguments, Surroundings(folder), kill_after(after))
            if ended.code != 0 or number:  # a second one may have had little left to do
                break
            shutil.rmtree(folder)
            folder.mkdir()
            task.prepare(bench, folder)
            after *= 0.8
        if (folder / task.output).exists():
            wrong += [f"after the kill at {fraction:.3f}: {part}" for part in half_written(folder / task.output)]
    return wrong


def check_task(task: Task, case: Case, bench: Bench) -> list[str]:
    """Kill a task, run it again, and compare."""
    expected = reference(task, bench)
    with bench.scratch() as folder:
        task.prepare(bench, folder)
        wrong = kill(task, bench, folder, moments(case.row, case.seed), expected.seconds)
        return [*wrong, *finished_wrongly(task, bench, folder, resume=case.seed % 2 == 0)]


def row_of(name: str, count: int, sample: int, variants: Sequence[Task]) -> Row:
    """The row of a command and of what it can be told to write."""

    def task_of(seed: int) -> Task:
        return variants[seed % len(variants)]

    def cases(count: int, seed: int) -> list[Case]:
        seeds = [seed * 1_000_003 + number for number in range(count)]
        faults = {s: " and ".join(f"{fraction:.4f}" for fraction in moments(name, s)) for s in seeds}
        return [Case(name, task_of(s).name, f"kill -9 at {faults[s]} of its time", s, EXPECTATION) for s in seeds]

    command = variants[0].command
    return Row(
        name=name,
        does=f"`kill -9` of `ggavatar-{command}` at random moments, then the same command again",
        passes_when="the output is bit-identical to that of an undisturbed command, nothing half written, no leftovers",
        count=count,
        sample=sample,
        cases=cases,
        check=lambda case, bench: check_task(task_of(case.seed), case, bench),
    )


COMMANDS: dict[str, tuple[int, int, tuple[Task, ...]]] = {
    "train": (100, 2, (tasks.TRAIN,)),
    "prep": (40, 1, (tasks.PREP,)),
    "eval": (30, 1, (tasks.EVAL,)),
    "sweep": (20, 0, (tasks.SWEEP,)),
    "export": (20, 1, tasks.EXPORTS),
    "render": (20, 1, (tasks.RENDER, tasks.ORBIT)),
}
"""Kills in all, those of a sample, and the tasks, by command."""

ROWS: tuple[Row, ...] = tuple(row_of(f"kill-{name}", *values) for name, values in COMMANDS.items())
