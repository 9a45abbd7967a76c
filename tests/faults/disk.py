"""The disk fails: it is full at some moment, read-only, or the output folder is gone.

A full disk is a tmpfs of the size of the inputs and a random part of what the command writes; where mounting is not
allowed, no file may grow beyond a random size (`ulimit -f`). A disk becomes read-only between a kill and the next try.
A folder is moved away at a random moment: it must not come back, and what was in it must be whole.
"""

from __future__ import annotations

import contextlib
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

from tests.faults import tasks
from tests.faults.bench import Bench, Event, Surroundings, kill_after
from tests.faults.case import Case, Row
from tests.faults.contents import contents, differences, half_written
from tests.faults.endings import complaints
from tests.faults.small_disk import can_mount, small_disk
from tests.faults.tasks import Task
from tests.faults.undisturbed import finished_wrongly, reference

FULL, READ_ONLY, REMOVED = "full disk", "read-only disk", "folder moved away"
EXPECTATION = "exit code 1 with one message; what was there is intact; with room again it ends bit-identically"
TASKS = (
    tasks.TRAIN,
    tasks.PREP,
    tasks.EVAL,
    tasks.RENDER,
    tasks.DEMO,
    tasks.SWEEP,
    *tasks.EXPORTS[3:6],
)
BLOCK = 512
"""Unit of `ulimit -f`, bytes."""
FAILED = 1
CELLS = 2
"""Trainings of a sweep, each of which has a message."""


def cases(count: int, seed: int) -> list[Case]:
    """Cases that go through the kinds of fault and the commands, each with a random part of the work before it."""
    kinds = (FULL, READ_ONLY, REMOVED) if can_mount() else (FULL, REMOVED)
    found = []
    for number in range(count):
        own = seed * 1_000_003 + number
        kind, task = kinds[own % len(kinds)], TASKS[own // len(kinds) % len(TASKS)]
        found.append(Case("disk", task.name, f"{kind} after {_fraction(own):.4f} of its work", own, EXPECTATION))
    return found


def check(case: Case, bench: Bench) -> list[str]:
    """Let the disk fail, then mend it and let the command finish."""
    task = next(task for task in TASKS if task.name == case.command)
    kind = case.fault.partition(" after ")[0]
    act = {READ_ONLY: _read_only, REMOVED: _removed, FULL: _full if can_mount() else _limited}[kind]
    with bench.scratch() as folder:
        return act(task, case, bench, folder)


def _fraction(seed: int) -> float:
    return random.Random(f"disk {seed}").random()


def _messages(task: Task) -> int:
    return CELLS + 1 if task.command == "sweep" else 1


def _full(task: Task, case: Case, bench: Bench, folder: Path) -> list[str]:
    expected = reference(task, bench)
    with small_disk(folder) as disk:
        task.prepare(bench, folder)
        before = contents(folder)
        disk.resize(disk.used + int(_fraction(case.seed) * expected.size))
        ended = bench.run(task.command, task.arguments(bench), Surroundings(folder))
        wrong = complaints(ended, {0, FAILED}, _messages(task)) + _harm(task, folder, before)
        disk.resize(1 << 30)
        return wrong + finished_wrongly(task, bench, folder, resume=True)


def _limited(task: Task, case: Case, bench: Bench, folder: Path) -> list[str]:
    largest = max(int(_fraction(case.seed) * reference(task, bench).size) // 4, BLOCK)
    task.prepare(bench, folder)
    before = contents(folder)
    around = Surroundings(folder, shell=f"ulimit -f {largest // BLOCK}")
    wrong = complaints(bench.run(task.command, task.arguments(bench), around), {0, FAILED}, _messages(task))
    return wrong + _harm(task, folder, before) + finished_wrongly(task, bench, folder, resume=True)


def _read_only(task: Task, case: Case, bench: Bench, folder: Path) -> list[str]:
    expected = reference(task, bench)
    with small_disk(folder) as disk:
        task.prepare(bench, folder)
        moment = kill_after(_fraction(case.seed) * expected.seconds)
        bench.run(task.command, task.arguments(bench), Surroundings(folder), moment)
        before = contents(folder)
        disk.make_read_only()
        flags = ("--resume",) if task.can_resume and (folder / task.output).exists() else ()
        ended = bench.run(task.command, (*task.arguments(bench), *flags), Surroundings(folder))
        is_finished = expected.contents.items() <= contents(folder / task.output).items()
        # 2: "already there", from a command that was finished, or that has begun nothing yet to resume.
        wrong = complaints(
            ended, {FAILED, 0, 2} if is_finished else {FAILED, 2} if flags else {FAILED}, _messages(task)
        )
        wrong += [f"on a read-only disk: {part}" for part in differences(contents(folder), before)]
        disk.resize(1 << 30)
        return wrong + finished_wrongly(task, bench, folder, resume=True)


def _removed(task: Task, case: Case, bench: Bench, folder: Path) -> list[str]:
    expected = reference(task, bench)
    task.prepare(bench, folder)
    output, moved = folder / task.output, folder / "moved away"
    event = Event(_fraction(case.seed) * expected.seconds, _mover(output, moved))
    ended = bench.run(task.command, task.arguments(bench), Surroundings(folder), event)
    if not moved.exists():  # it had ended before
        return complaints(ended, {0})
    is_whole = expected.contents.items() <= contents(moved).items()
    reads_there = task.prepare is tasks.copy_of_run and task.output == "run"
    codes = {FAILED, *((0,) if is_whole else ()), *((2,) if reads_there else ())}
    wrong = complaints(ended, codes, _messages(task))
    if output.exists():
        wrong.append(f"{task.output} came back with {sorted(contents(output)) or 'nothing in it'}")
    wrong += half_written(moved)
    if output.exists() or reads_there:
        return wrong
    return wrong + finished_wrongly(task, bench, folder, resume=False)


def _mover(output: Path, target: Path) -> Callable[[int], None]:
    """What moves a folder away as soon as it exists, while the process group lives."""

    def act(group: int) -> None:
        while True:
            with contextlib.suppress(FileNotFoundError):
                output.rename(target)
                return
            try:
                os.killpg(group, 0)
            except ProcessLookupError:
                return
            time.sleep(0.01)

    return act


def _harm(task: Task, folder: Path, before: dict[str, str]) -> list[str]:
    """What is half written, and what was there before and is no more, or other than it was."""
    now = contents(folder)
    harm = [
        f"{name}: was there before, and is not intact" for name, digest in before.items() if now.get(name) != digest
    ]
    output = folder / task.output
    return [*harm, *(half_written(output) if output.exists() else [])]


ROWS: tuple[Row, ...] = (
    Row(
        name="disk",
        does="disk full at a random moment, read-only, output folder moved away, then the same command again",
        passes_when="exit code 1, one message, earlier work intact; run again it ends bit-identically",
        count=60,
        sample=2,
        cases=cases,
        check=check,
    ),
)
