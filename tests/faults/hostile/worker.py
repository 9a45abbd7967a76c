"""The process that opens hostile files: one for many fixtures, watched, with bounded memory."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import io
import os
import resource
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

from ggavatar.errors import InputError
from tests.faults.hostile.bases import Trees
from tests.faults.hostile.fixture import ACCEPTED, FAULT, REFUSED, Fixture, Reading, remove
from tests.faults.hostile.readers import CommandFailed, Reader, reader_of
from tests.faults.hostile.watch import Watch, state_of

MAX_SECONDS, MAX_MEGABYTES = 10.0, 1000.0
"""What a fixture may take: seconds of the processor, which other programs on the machine do not change, and memory."""
_C = ctypes.CDLL(None)
_ADDRESS_SPACE = 3 << 30
"""Bytes that may be reserved beyond the beginning: a guard for the machine; memory that is used is measured."""


def work(connection: Connection, originals: Path, sandbox: Path) -> None:
    """Open each fixture that comes and send back its reading, until the connection is closed.

    Args:
        connection: To the parent, which sends None before the last.
        originals: Folder of the valid trees.
        sandbox: Folder of this worker alone, for its copies of them and for the files that must not change.
    """
    devices = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(devices, stream)
    desk = Desk(Trees(originals, sandbox))
    with contextlib.suppress(EOFError, OSError):
        while (fixture := connection.recv()) is not None:
            try:
                desk.warm(fixture)
            except BaseException:
                connection.send(traceback.format_exc())
                return
            connection.send("")
            connection.send(desk.read(fixture))


class Desk:
    """Where fixtures are opened and judged; one in a process.

    Args:
        trees: Copies of the valid trees.
    """

    def __init__(self, trees: Trees) -> None:
        self._trees, self._watch = trees, Watch()
        self._warm: set[tuple[str, str, str]] = set()
        os.chdir(trees.sandbox)

    def warm(self, fixture: Fixture) -> None:
        """Read the unchanged tree first, so that every module is loaded and kernel compiled before something counts."""
        key = (fixture.reader, fixture.base, fixture.target)
        if key in self._warm:
            return
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        reader, tree = reader_of(fixture.reader), self._trees.copy(fixture.base)
        for name in reader.forgets:  # what it made earlier, and would only read again
            remove(tree / name)
        absent = () if (tree / fixture.target).exists() else (InputError,)  # no file of that kind is valid
        with _quiet(), contextlib.suppress(*absent):
            reader.open(tree / fixture.target)
        self._trees.restore(fixture.base, None if reader.writes else ())
        gc.collect()
        gc.freeze()
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + _ADDRESS_SPACE, resource.RLIM_INFINITY))
        self._warm.add(key)

    def read(self, fixture: Fixture) -> Reading:
        """Plant a fixture, open it, judge, and restore the tree."""
        tree, reader = self._trees.copy(fixture.base), reader_of(fixture.reader)
        changed = fixture.plant(tree)
        for name in reader.forgets if reader.anew else ():
            remove(tree / name)
        before, memory = state_of(self._trees.sandbox), _reset_peak()
        self._watch.start((tree, self._trees.scratch) if reader.writes else (self._trees.scratch,))
        began = time.process_time()
        verdict, detail = _open(reader, tree / fixture.target)
        cost = (time.process_time() - began, 0.0)
        events = self._watch.stop()
        cost = (cost[0], max(0.0, _status("VmHWM") - memory))
        events += self._changes(before, tree if reader.writes else None)
        self._trees.restore(fixture.base, None if reader.writes else changed)
        if wrong := judge(fixture, changed, (verdict, detail), events, cost):
            return Reading(FAULT, wrong[:2000], *cost)
        return Reading(verdict, detail[:2000], *cost)

    def _changes(self, before: dict[str, tuple[int, int, int]], own: Path | None) -> list[str]:
        """What is no longer as it was in the sandbox, outside of what the reader may write."""
        after = state_of(self._trees.sandbox)
        allowed = (str(self._trees.scratch), *((str(own),) if own else ()))
        names = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
        return [f"{name} was changed or made" for name in sorted(names) if not name.startswith(allowed)]


def judge(
    fixture: Fixture,
    changed: Sequence[str],
    result: tuple[str, str],
    events: Sequence[str],
    cost: tuple[float, float],
) -> str:
    """What is wrong with a reading; empty if nothing is."""
    (verdict, detail), (seconds, megabytes), reader = result, cost, reader_of(fixture.reader)
    if events:
        return f"{'; '.join(events)} ({detail})"
    if verdict == FAULT:
        return detail
    if seconds > MAX_SECONDS or megabytes > MAX_MEGABYTES:
        return f"took {seconds:.1f} s and {megabytes:.0f} MB ({verdict}: {detail})"
    if verdict == ACCEPTED:
        return "was read, expected it to be refused" if fixture.must_refuse else ""
    names = {Path(name).name for name in (*changed, fixture.target)} | {f"/{fixture.base}"}
    if not any(name in detail for name in names):
        return f"names none of {', '.join(sorted(names))}: {detail}"
    return f"a message of {len(detail)} characters: {detail}" if len(detail) > reader.longest else ""


def _open(reader: Reader, path: Path) -> tuple[str, str]:
    """Verdict and message of one reading."""
    try:
        with _quiet():
            result = reader.open(path)
    except (InputError, CommandFailed) as error:
        return REFUSED, str(error)
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "site-packages" not in frame.filename and "/hostile/" not in frame.filename]
        where = " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(own))
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
    _C.malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _status(name: str) -> float:
    """A size in /proc/self/status, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return float(line.split()[1]) * 1024 / 1e6
    return 0.0
