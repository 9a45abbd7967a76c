"""Where faults are injected: temporary folders, things that cases share, and commands in processes of their own."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.mutations.mutation import ROOT

LIMIT = 900.0
"""Time after which a command counts as hung, s."""


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        code: Exit code; negative is the number of the signal that killed it, None means it hung and was killed.
        output, errors: What it wrote to stdout and stderr.
        seconds: Wall time, s.
    """

    code: int | None
    output: str
    errors: str
    seconds: float

    @property
    def last_words(self) -> str:
        """Exit code and the end of what it said, for a report."""
        said = (self.errors.strip() or self.output.strip())[-600:]
        return f"exit code {self.code} after {self.seconds:.1f} s: {said or 'no message'}"


@dataclass(frozen=True)
class Surroundings:
    """What a command runs in besides its arguments.

    Attributes:
        folder: Working directory.
        environment: Changes to the environment; None removes a variable.
        shell: Line of a POSIX shell that runs before the command takes its place, such as `ulimit -n 64`; may also
            redirect: `exec >&-`.
    """

    folder: Path
    environment: Mapping[str, str | None] = field(default_factory=dict)
    shell: str = ""


@dataclass(frozen=True)
class Event:
    """Something that happens to a command while it works.

    Attributes:
        after: Time after its start, s.
        act: Called with the number of its process group.
    """

    after: float
    act: Callable[[int], None]


class Bench:
    """A temporary folder with what the cases of all rows share; every method may be called from several threads.

    Attributes:
        folder: Of everything; removed by whoever made it.
        jobs: Cases that run at a time.
    """

    def __init__(self, folder: Path, program: Callable[[str], Sequence[str]] | None = None, jobs: int = 2) -> None:
        """Make a bench.

        Args:
            folder: An empty folder.
            jobs: Cases that run at a time.
            program: The first words of the command line of a command such as `train`; by default its console script.
        """
        self.folder, self.jobs = folder, jobs
        self._program = program or console_script
        self._made: dict[str, Any] = {}
        self._locks: dict[str, threading.Lock] = {}
        self._guard = threading.Lock()
        self._numbers = itertools.count()

    def once(self, name: str, make: Callable[[Path], Any]) -> Any:
        """What `make` returned or raised when it was first asked for `name`; its folder does not exist yet."""
        with self._guard:
            lock = self._locks.setdefault(name, threading.Lock())
        with lock:
            if name not in self._made:
                (self.folder / "shared").mkdir(exist_ok=True)
                try:
                    self._made[name] = make(self.folder / "shared" / name)
                except Exception as error:
                    self._made[name] = error
            made = self._made[name]
        if isinstance(made, Exception):
            raise made
        return made

    @contextlib.contextmanager
    def scratch(self) -> Iterator[Path]:
        """An empty folder that is removed afterwards."""
        folder = self.folder / f"case-{next(self._numbers):05d}"
        folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def run(
        self,
        command: str,
        arguments: Sequence[object],
        around: Surroundings,
        event: Event | None = None,
        limit: float = LIMIT,
    ) -> Ended:
        """Run one of our commands in a process group of its own and wait for its end.

        Args:
            command: Such as `train`.
            arguments: Its arguments.
            around: Working directory, environment, limits.
            event: What happens to it meanwhile.
            limit: Time after which it counts as hung, s.
        """
        line = [*self._program(command), *map(str, arguments)]
        if around.shell:
            line = ["/bin/sh", "-c", f'{around.shell}\nexec "$@"', "sh", *line]
        began = time.monotonic()
        process = subprocess.Popen(
            line,
            cwd=around.folder,
            env=_environment(around.environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        timer = None
        if event is not None:
            timer = threading.Timer(event.after, event.act, (process.pid,))
            timer.start()
        try:
            output, errors = process.communicate(timeout=limit)
            code: int | None = process.returncode
        except subprocess.TimeoutExpired:
            signal_group(process.pid, signal.SIGKILL)
            output, errors = process.communicate()
            code = None
        finally:
            if timer is not None:
                timer.cancel()
                timer.join()
            signal_group(process.pid, signal.SIGKILL)  # children that have outlived it
        texts = (data.decode("utf-8", errors="replace") for data in (output, errors))
        return Ended(code, *texts, time.monotonic() - began)


def console_script(command: str) -> list[str]:
    """The console script of a command such as `train`, as users run it."""
    found = shutil.which(f"ggavatar-{command}", path=str(Path(sys.executable).parent))
    assert found, f"ggavatar-{command} is not installed beside {sys.executable}: run make .venv/installed-dev"
    return [found]


def signal_group(group: int, number: int) -> None:
    """Send a signal to a process group, if there still is one."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, number)


def kill_after(seconds: float) -> Event:
    """SIGKILL for a command and all its children."""
    return Event(seconds, lambda group: signal_group(group, signal.SIGKILL))


def _environment(changes: Mapping[str, str | None]) -> dict[str, str]:
    """The environment of commands: ours, with the checkout first, one thread, no network, and the changes."""
    merged: dict[str, str | None] = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
        "GGAVATAR_OFFLINE": "1",
        "PYTHONDONTWRITEBYTECODE": None,
        **changes,
    }
    return {name: value for name, value in merged.items() if value is not None}
