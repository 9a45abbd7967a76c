"""Notices in this process what reading a file must never do: run code, start a program, connect, write.

Python's audit hooks report what goes through Python. What native code does is seen by its effect: the files around the
one that is read must stay what they were.
"""

from __future__ import annotations

import contextlib
import os
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_FORBIDDEN = (
    *("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.startfile", "os.fork", "os.forkpty", "pty.spawn"),
    *("subprocess.Popen", "socket.connect", "socket.bind", "socket.sendto", "socket.getaddrinfo", "urllib.Request"),
    *("pickle.find_class", "ctypes.dlopen", "webbrowser.open", "ftplib.connect", "smtplib.connect"),
)
"""Events that no reading causes once its modules are loaded."""
_CHANGING = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "os.chown", "os.link", "os.symlink")
_CHANGING += ("os.truncate", "shutil.rmtree", "shutil.move", "shutil.copyfile", "os.utime", "os.setxattr")
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_GENERATORS = ("/dataclasses.py", "/collections/__init__.py", "/typing.py", "/enum.py", "/tyro/_calling.py")
"""Modules that make functions of classes out of text."""
_PROJECT = Path(__file__).resolve().parents[3]


class Watch:
    """What happened since `start`, as sentences; installed once in a process, since hooks cannot be removed.

    Args:
        code: Files below which code may lie that is run, such as modules that are imported on first use.
    """

    def __init__(self, code: Iterable[Path] = ()) -> None:
        roots = {Path(sysconfig.get_paths()[name]) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
        roots |= {Path(sys.prefix), Path(sys.base_prefix), _PROJECT, *code}
        self._roots = tuple(f"{place}/" for root in roots for place in {root, root.resolve()})
        self._found: list[str] | None = None
        self._writable: tuple[str, ...] = ()
        sys.addaudithook(self._hook)

    def start(self, writable: Iterable[Path]) -> None:
        """Begin to watch; files may be written below the given folders only."""
        self._writable = (*(f"{folder}/" for folder in writable), os.devnull)
        self._found = []

    def stop(self) -> list[str]:
        """End watching; what was seen."""
        found, self._found = self._found or [], None
        return found

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        found = self._found
        if found is None or len(found) > 20:
            return
        if event in _FORBIDDEN and arguments != (None,):  # dlopen(None) is the process itself
            found.append(f"{event}{arguments!r:.200}")
        elif event == "exec":
            place = getattr(arguments[0], "co_filename", "?")
            caller = sys._getframe(1).f_code.co_filename
            if not place.startswith((*self._roots, "<frozen ")) and not caller.endswith(_GENERATORS):
                found.append(f"exec of code from {place} by {caller}")
        elif event == "open":
            name, mode, flags = arguments
            writes = set(mode or "") & set("wax+") or (isinstance(flags, int) and flags & _WRITING)
            if writes and not isinstance(name, int):
                self._check_write(event, name, found)
        elif event in _CHANGING:
            self._check_write(event, _full(*arguments), found)

    def _check_write(self, event: str, name: object, found: list[str]) -> None:
        if isinstance(name, int):
            return
        path = os.path.abspath(os.fsdecode(name)) if isinstance(name, str | bytes | os.PathLike) else str(name)
        if not (path + "/").startswith(self._writable):
            found.append(f"{event} {path}")


def _full(name: object, *others: object) -> object:
    """A name that is relative to an opened folder, the last argument of such events, as a path."""
    folder = others[-1] if others else -1
    if isinstance(folder, int) and folder >= 0 and isinstance(name, str) and not os.path.isabs(name):
        with contextlib.suppress(OSError):
            return os.path.join(os.readlink(f"/proc/self/fd/{folder}"), name)
    return name


def state_of(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Mode, size and time of every file below a folder, for comparison."""
    found = {}
    for home, folders, names in os.walk(folder):
        for name in (*folders, *names):
            status = os.lstat(os.path.join(home, name))
            folderish = 0 if name in folders else status.st_mtime_ns
            found[os.path.join(home, name)] = (status.st_mode, 0 if name in folders else status.st_size, folderish)
    return found
