"""The process that opens hostile files: one for many cases, watched, with bounded memory.

It reports the beginning and the end of every case, so that its parent knows which one hung or crashed it.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import resource
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

from ggavatar.errors import InputError
from tests.faults.hostile.case import ACCEPTED, FAULT, REFUSED, Case, Outcome, remove
from tests.faults.hostile.readers import READERS, CommandFailed, Reader
from tests.faults.hostile.watch import Watch, state_of

MAX_SECONDS, MAX_MEGABYTES = 10.0, 1000.0
_ADDRESS_SPACE = 3 << 30
"""What may be reserved beyond the beginning: a guard for the machine; memory that is used is measured."""


def work(connection: Connection, bases: Path, sandbox: Path, cases: Sequence[Case]) -> None:
    """Open every case and send `("begin", index)` and then `("end", outcome)`."""
    sandbox.mkdir(parents=True, exist_ok=True)
    os.chdir(sandbox)
    devices = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(devices, stream)
    bench = Bench(bases, sandbox)
    for reader, base, target in dict.fromkeys((case.reader, case.base, case.target) for case in cases):
        bench.warm(reader, base, target)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _ADDRESS_SPACE, resource.RLIM_INFINITY))
    for index, case in enumerate(cases):
        connection.send(("begin", index))
        connection.send(("end", bench.run(case)))
    connection.close()


class Bench:
    """Where cases are opened: a copy of each tree, restored after every case.

    Args:
        bases: Folder of the valid trees.
        sandbox: Folder of the copies and of the victims.
    """

    def __init__(self, bases: Path, sandbox: Path) -> None:
        self._bases, self._sandbox = bases, sandbox
        self._watch = Watch()
        (sandbox / "victim.txt").write_text("must stay")
        (sandbox / "scratch").mkdir(exist_ok=True)

    def _tree(self, base: str) -> Path:
        tree = self._sandbox / base
        if not tree.exists():
            shutil.copytree(self._bases / base, tree, symlinks=True)
        return tree

    def warm(self, reader: str, base: str, target: str) -> None:
        """Read the unchanged tree, so that every module is loaded and every kernel compiled before the first case."""
        tree = self._tree(base)
        with _quiet():
            READERS[reader].open(tree / target)
        self._restore(base, None)

    def run(self, case: Case) -> Outcome:
        """Plant a case, open it, judge, and restore the tree."""
        tree, reader = self._tree(case.base), READERS[case.reader]
        changed = case.plant(tree)
        gc.collect()
        before, memory = state_of(self._sandbox), _reset_peak()
        writable = (tree, self._sandbox / "scratch") if reader.writes else (self._sandbox / "scratch",)
        self._watch.start(writable)
        began = time.monotonic()
        verdict, detail = _open(reader, tree / case.target)
        seconds = time.monotonic() - began
        events = self._watch.stop()
        megabytes = max(0.0, _peak() - memory)
        events += self._changes(before, tree if reader.writes else None)
        detail = _judge(case, reader, changed, verdict, detail, events, (seconds, megabytes)) or detail
        faulty = detail.startswith("fault: ")
        self._restore(case.base, None if reader.writes else changed)
        return Outcome(case.name, FAULT if faulty else verdict, detail[:2000], seconds, megabytes)

    def _changes(self, before: dict[str, tuple[int, int, int]], own: Path | None) -> list[str]:
        """What is no longer as it was in the sandbox, outside of what the reader may write."""
        after = state_of(self._sandbox)
        allowed = (f"{self._sandbox}/scratch", *((str(own),) if own else ()))
        names = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
        return [f"{name} was changed or made" for name in sorted(names) if not name.startswith(allowed)]

    def _restore(self, base: str, changed: Sequence[str] | None) -> None:
        """Undo a case: the files that were changed, or the whole tree where a command wrote into it."""
        tree = self._sandbox / base
        if changed is None:
            remove(tree)
            shutil.copytree(self._bases / base, tree, symlinks=True)
        for name in changed or ():
            remove(tree / name)
            original = self._bases / base / name
            if original.is_file():
                shutil.copyfile(original, tree / name)
        shutil.rmtree(self._sandbox / "scratch")
        (self._sandbox / "scratch").mkdir()
        for extra in self._sandbox.iterdir():
            if extra.name not in (base, "scratch") and not (self._bases / extra.name).exists():
                remove(extra)
        (self._sandbox / "victim.txt").write_text("must stay")


def _judge(
    case: Case,
    reader: Reader,
    changed: Sequence[str],
    verdict: str,
    detail: str,
    events: Sequence[str],
    cost: tuple[float, float],
) -> str:
    """What is wrong with an outcome, beginning with `fault: `; empty if nothing is."""
    if events:
        return f"fault: {'; '.join(events)}"
    if verdict == FAULT:
        return f"fault: {detail}"
    if cost[0] > MAX_SECONDS or cost[1] > MAX_MEGABYTES:
        return f"fault: took {cost[0]:.1f} s and {cost[1]:.0f} MB ({verdict}: {detail})"
    if verdict == ACCEPTED:
        return "fault: was read, expected it to be refused" if case.must_refuse else ""
    names = {Path(name).name for name in (*changed, case.target)} | {case.base}
    if not any(name in detail for name in names) and not reader.anonymous:
        return f"fault: names none of {', '.join(sorted(names))}: {detail}"
    if len(detail) > reader.longest:
        return f"fault: a message of {len(detail)} characters: {detail}"
    return ""


def _open(reader: Reader, path: Path) -> tuple[str, str]:
    """Verdict and message of one reading."""
    try:
        with _quiet():
            result = reader.open(path)
    except (InputError, CommandFailed) as error:
        return REFUSED, str(error)
    except BaseException as error:
        import traceback

        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/site-packages/" not in frame.filename]
        where = " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(frames[1:]))
        return FAULT, f"{type(error).__name__}: {str(error)[:300]} ({where})"
    return ACCEPTED, str(result or "")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what libraries print; warnings are no fault."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


def _reset_peak() -> float:
    """Memory in use, MB; the peak begins anew."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _peak() -> float:
    return _status("VmHWM")


def _status(name: str) -> float:
    """A value of /proc/self/status, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return float(line.split()[1]) * 1024 / 1e6
    return 0.0
