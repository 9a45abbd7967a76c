"""Every command in surroundings that are not what it is used to: signals, streams, limits, locales, names, caches.

Each command meets each of them. A signal comes at a random moment. Names are those of the command's inputs and output.
Caches are copies of the user's own with a tenth of the files damaged; an empty one is filled by two commands at once.
"""

from __future__ import annotations

import functools
import random
import shutil
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ggavatar.io.cache_folder import cache_folder
from ggavatar.jit.kernel_cache import source_digest
from tests.faults import tasks
from tests.faults.bench import Bench, Event, Surroundings, signal_group
from tests.faults.case import Case, Row
from tests.faults.contents import contents, differences, half_written
from tests.faults.endings import complaints
from tests.faults.small_disk import can_mount, small_disk
from tests.faults.tasks import Task
from tests.faults.undisturbed import reference
from tests.mutations.mutation import ROOT

TASKS = (
    tasks.DEMO,
    tasks.PREP,
    tasks.DOCTOR,
    tasks.TRAIN,
    tasks.EVAL,
    tasks.RENDER,
    tasks.EXPORTS[0],
    tasks.ONE_CELL,
    tasks.MODELS,
)
SUCCESS, FAILED, BAD_INPUT = 0, 1, 2
INTERRUPTED, TERMINATED = {130, -signal.SIGINT}, {143, -signal.SIGTERM}
"""What a shell shows for a command that a signal has ended is 128 and the number of the signal."""
PACKAGES = ("ggavatar", "preprocess", "evaluate")
LINES_OF_SWEEP = 2
"""Messages of a sweep: its own, and that of its training."""


@dataclass(frozen=True)
class Fault:
    """Surroundings of a command.

    Attributes:
        name: In words.
        expectation: In words.
        act: Runs the command in them, in an empty folder, and says what is wrong.
    """

    name: str
    expectation: str
    act: Callable[[Task, Bench, Path, int], list[str]]


def _plain(codes: set[int], environment: dict[str, str | None] | None = None, shell: str = "") -> Callable:
    """Run the command with another environment, or after a line of the shell."""

    def act(task: Task, bench: Bench, folder: Path, seed: int) -> list[str]:
        task.prepare(bench, folder)
        ended = bench.run(task.command, task.arguments(bench), Surroundings(folder, environment or {}, shell))
        messages = LINES_OF_SWEEP if task.command == "sweep" else 1
        return [*complaints(ended, codes, messages), *_half_written(task, folder)]

    return act


def _signal(number: int, codes: set[int]) -> Callable:
    def act(task: Task, bench: Bench, folder: Path, seed: int) -> list[str]:
        seconds = reference(task, bench).seconds
        task.prepare(bench, folder)
        event = Event(random.Random(seed).random() * seconds, lambda group: signal_group(group, number))
        ended = bench.run(task.command, task.arguments(bench), Surroundings(folder), event)
        if "Traceback" in ended.errors and not any(f'File "{ROOT / name}' in ended.errors for name in PACKAGES):
            return []  # Python itself was still starting
        # A command may have ended before.
        return [*complaints(ended, codes | {SUCCESS}), *_half_written(task, folder), *_left_over(folder)]

    return act


def _named(name: str, codes: set[int]) -> Callable:
    """Run the command with this name for its output and for each of its inputs."""

    def act(task: Task, bench: Bench, folder: Path, seed: int) -> list[str]:
        task.prepare(bench, folder)
        arguments = [_renamed(argument, task, folder, name) for argument in task.arguments(bench)]
        ended = bench.run(task.command, arguments, Surroundings(folder))
        wrong = complaints(ended, codes)
        output = folder / f"{name}{Path(task.output).suffix}"
        if ended.code == SUCCESS and task.output and not output.exists():
            wrong.append(f"expected {output.name!r}, found {sorted(path.name for path in folder.iterdir())}")
        return wrong

    return act


def _renamed(argument: object, task: Task, folder: Path, name: str) -> object:
    """An argument, or the odd name of the input or output that it stands for."""
    if argument in (task.output, "run"):
        odd = f"{name}{Path(str(argument)).suffix}" if argument == task.output else f"{name} of a run"
        if (folder / str(argument)).exists():
            (folder / str(argument)).rename(folder / odd)
        return odd
    if not isinstance(argument, Path):
        return argument
    place = folder / "given" / f"{argument.name} of" / f"{name}{argument.suffix}"
    place.parent.mkdir(parents=True)
    (shutil.copytree if argument.is_dir() else shutil.copyfile)(argument, place)
    return place.relative_to(folder)


def _with_read_only_cache(task: Task, bench: Bench, folder: Path, seed: int) -> list[str]:
    """The cache is there, but nothing can be written into it."""
    cache = folder / "cache"
    cache.mkdir()
    act = _plain({SUCCESS}, {"GGAVATAR_CACHE": str(cache)})
    if not can_mount():
        cache.chmod(0o500)
        return act(task, bench, folder, seed)
    with small_disk(cache) as disk:
        disk.make_read_only()
        return act(task, bench, folder, seed)


def _two_first(task: Task, bench: Bench, folder: Path, seed: int) -> list[str]:
    """Two commands with an empty cache, at the same time, in folders of their own."""

    def one(name: str) -> list[str]:
        own = folder / name
        own.mkdir()
        task.prepare(bench, own)
        around = Surroundings(own, {"GGAVATAR_CACHE": str(folder / "cache")})
        ended = bench.run(task.command, task.arguments(bench), around)
        return [*complaints(ended, {SUCCESS}), *_half_written(task, own)]

    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(one, ("first", "second"))
    results = [contents(folder / name / task.output) if task.output else {} for name in ("first", "second")]
    return [*first, *second, *differences(*results)]


def _damaged_cache(damage: Callable[[bytes, random.Random], bytes]) -> Callable:
    """Some files of the compiled kernels are other than they were written."""

    def act(task: Task, bench: Bench, folder: Path, seed: int) -> list[str]:
        expected = reference(task, bench).contents if task.output else {}
        cache, draw = folder / "cache", random.Random(seed)
        compiled = cache / "ggavatar" / "compiled"
        compiled.mkdir(parents=True, mode=0o700)
        for name in todays_kernels():
            if (cache_folder("compiled") / name).is_dir():
                shutil.copytree(cache_folder("compiled") / name, compiled / name)
        files = sorted(path for path in compiled.rglob("*") if path.is_file())
        for path in draw.sample(files, -(-len(files) // 10)):
            path.write_bytes(damage(path.read_bytes(), draw))
        wrong = _plain({SUCCESS}, {"GGAVATAR_CACHE": str(cache)})(task, bench, folder, seed)
        return [*wrong, *(differences(contents(folder / task.output), expected) if task.output else [])]

    return act


@functools.cache
def todays_kernels() -> tuple[str, ...]:
    """Names of the folders of compiled kernels that belong to the sources as they are."""
    sources = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    kernels = [path for path in sources if "ggavatar.jit.kernels import" in path.read_text(encoding="utf-8")]
    return tuple(source_digest(path) for path in kernels)


def _cut(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data))] if data else data


def _flipped(data: bytes, draw: random.Random) -> bytes:
    if not data:
        return data
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ 1 << draw.randrange(8)]) + data[place + 1 :]


def _foreign(data: bytes, draw: random.Random) -> bytes:
    """A pickle that ends the process with exit code 77, in place of the file."""
    return b"cposix\n_exit\n(I77\ntR."


def _half_written(task: Task, folder: Path) -> list[str]:
    output = folder / task.output
    return half_written(output) if task.output and output.exists() else []


def _left_over(folder: Path) -> list[str]:
    """What an orderly end leaves of temporary files and locks."""
    odd = (".part", ".lock", ".lock.json")
    return [f"left {path.name}" for path in folder.rglob(".*") if path.name.endswith(odd) or ".partial." in path.name]


ASCII = {"LC_ALL": "C", "LANG": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
GIBIBYTE = 1 << 20
"""In the unit of `ulimit -v`, KiB."""
NAMES = {
    "spaces": "a b  c",
    "umlauts": "Ännchen Öre",
    "a newline": "one\ntwo",
    "an emoji": "face 🙂",
    "200 characters": "n" * 200,
    "quotes and wildcards": 'it\'s "*" $HOME',
}
WORKS = "exit code 0"
FAULTS = (
    Fault("SIGINT", "exit code 130, nothing half written", _signal(signal.SIGINT, INTERRUPTED)),
    Fault("SIGTERM", "exit code 143, nothing half written", _signal(signal.SIGTERM, TERMINATED)),
    Fault("closed stdout", WORKS, _plain({SUCCESS}, shell="exec >&-")),
    Fault("closed stdin, stdout and stderr", WORKS, _plain({SUCCESS}, shell="exec <&- >&- 2>&-")),
    Fault("stdout on a full device", "exit code 1, one message", _plain({SUCCESS, FAILED}, shell="exec >/dev/full")),
    Fault("no HOME", WORKS, _plain({SUCCESS}, {"HOME": None, "XDG_CACHE_HOME": None})),
    Fault("a HOME that does not exist", WORKS, _plain({SUCCESS}, {"HOME": "/nonexistent", "XDG_CACHE_HOME": None})),
    Fault("a cache that cannot be written", WORKS, _with_read_only_cache),
    *(
        Fault(f"ulimit -v of {size} GiB", "exit code 0 or 1", _plain({SUCCESS, FAILED}, shell=f"ulimit -v {kibibytes}"))
        for size, kibibytes in (("0.4", GIBIBYTE * 2 // 5), ("1", GIBIBYTE), ("1.5", GIBIBYTE * 3 // 2))
    ),
    *(
        Fault(f"ulimit -n of {number}", "exit code 0 or 1", _plain({SUCCESS, FAILED}, shell=f"ulimit -n {number}"))
        for number in (12, 24, 64)
    ),
    Fault("the C locale and ASCII streams", WORKS, _plain({SUCCESS}, ASCII)),
    *(Fault(f"names with {what}", WORKS, _named(name, {SUCCESS})) for what, name in NAMES.items()),
    Fault("names with a leading dash", "exit code 0 or 2", _named("-dash", {SUCCESS, BAD_INPUT})),
    Fault("two first compilations at once", WORKS, _two_first),
    Fault("a cut cache", WORKS, _damaged_cache(_cut)),
    Fault("a cache with flipped bits", WORKS, _damaged_cache(_flipped)),
    Fault("a foreign cache", WORKS, _damaged_cache(_foreign)),
)
COUNT = len(FAULTS) * len(TASKS)


def cases(count: int, seed: int) -> Sequence[Case]:
    """Commands and surroundings in a shuffled order: all before any comes again, with other moments."""
    pairs = [(task, fault) for task in TASKS for fault in FAULTS]
    random.Random(seed).shuffle(pairs)
    found = [pairs[number % COUNT] for number in range(count)]
    return [
        Case("surroundings", task.name, fault.name, seed * 1_000_003 + number, fault.expectation)
        for number, (task, fault) in enumerate(found)
    ]


def check(case: Case, bench: Bench) -> list[str]:
    """Run the command in its surroundings."""
    task = next(task for task in TASKS if task.name == case.command)
    fault = next(fault for fault in FAULTS if fault.name == case.fault)
    with bench.scratch() as folder:
        return fault.act(task, bench, folder, case.seed)


ROWS: tuple[Row, ...] = (
    Row(
        name="surroundings",
        does=f"{len(TASKS)} commands × {len(FAULTS)} surroundings: SIGINT, SIGTERM, closed or full stdout, no HOME, "
        "unwritable, damaged, foreign or empty cache, little memory, few open files, C locale, odd names",
        passes_when="the right exit code, one message, no traceback, nothing half written",
        count=COUNT,
        sample=4,
        cases=cases,
        check=check,
    ),
)
