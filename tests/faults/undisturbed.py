"""Commands that nothing disturbs: what their output is, how long they take, and how they finish what was begun."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tests.faults.bench import Bench, Ended, Surroundings
from tests.faults.contents import contents, differences
from tests.faults.tasks import Task

PAGE = 4096
"""Smallest piece of a disk, bytes."""


@dataclass(frozen=True)
class Reference:
    """An undisturbed command.

    Attributes:
        contents: Digests of its output by file.
        seconds: How long it took, s.
        size: What it wrote, bytes on a disk.
    """

    contents: dict[str, str]
    seconds: float
    size: int


def reference(task: Task, bench: Bench) -> Reference:
    """The task without faults: twice, with as many at a time as there are cases, whose duration is the same then."""

    def make(folder: Path) -> Reference:
        with ThreadPoolExecutor(min(bench.jobs, 2)) as pool:
            first, second = pool.map(lambda _: _undisturbed(task, bench), range(2))
        assert not differences(*(part.contents for part in (first, second))), (
            f"{task.name} differs from itself: {differences(first.contents, second.contents)}"
        )
        return Reference(first.contents, (first.seconds + second.seconds) / 2, first.size)

    return bench.once(f"reference-{task.name}", make)


def _undisturbed(task: Task, bench: Bench) -> Reference:
    with bench.scratch() as folder:
        task.prepare(bench, folder)
        before = _size(folder)
        ended = bench.run(task.command, task.arguments(bench), Surroundings(folder))
        assert ended.code == 0, f"ggavatar-{task.command} failed without a fault: {ended.last_words}"
        return Reference(contents(folder / task.output), ended.seconds, _size(folder) - before)


def finish(task: Task, bench: Bench, folder: Path, resume: bool) -> Ended:
    """Run the task until it is done, with or without --resume first, and then as its message says."""
    arguments = task.arguments(bench)
    with_resume = task.can_resume and resume
    for _ in range(2):
        flags = ("--resume",) if with_resume else ()
        ended = bench.run(task.command, (*arguments, *flags), Surroundings(folder))
        if ended.code != 2 or not task.can_resume or "--resume" not in ended.errors:
            break
        with_resume = not with_resume
    return ended


def finished_wrongly(task: Task, bench: Bench, folder: Path, resume: bool) -> list[str]:
    """Finish the task in a folder, and say what is wrong with its end or its output."""
    ended = finish(task, bench, folder, resume)
    # What an export has finished before, it does not replace unasked.
    is_done = ended.code == 0 or (ended.code == 2 and "--overwrite" in ended.errors and not task.can_resume)
    wrong = [] if is_done else [f"run again: {ended.last_words}"]
    return [*wrong, *differences(contents(folder / task.output), reference(task, bench).contents)]


def _size(folder: Path) -> int:
    """What the files of a folder take on a disk, bytes."""
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return sum(-(-size // PAGE) * PAGE for size in sizes)
