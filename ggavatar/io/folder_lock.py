"""An advisory lock on an output folder: two commands never write into one folder at the same time.

The lock is the operating system's, held through the file `.lock` in the folder, so that a process that was killed holds
nothing. Beside it, `.lock.json` names the process for the message that the other one prints.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from ggavatar.errors import InputError
from ggavatar.io.atomic import require_folder
from ggavatar.io.json_files import read_json, write_json

LOCK_FILES = (".lock", ".lock.json")
"""Names of the files of a lock, which are not part of what a folder holds."""


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of an existing folder.

    Raises:
        InputError: Another process holds it.
        OSError: The folder does not exist or is not writable.
    """
    require_folder(folder)
    lock_path, owner_path = (folder / name for name in LOCK_FILES)
    lock = FileLock(lock_path)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise InputError(
            f"{folder}: {_owner(owner_path)} is writing into this folder; wait for it or stop it, or choose another "
            "folder with -o"
        ) from error
    except NotImplementedError:  # some network file systems have no locks
        yield
        return
    try:
        write_json(
            owner_path, {"process": os.getpid(), "host": socket.gethostname(), "command": Path(sys.argv[0]).name}
        )
        yield
    finally:
        owner_path.unlink(missing_ok=True)
        lock.release()


def _owner(path: Path) -> str:
    """The process that holds a lock, in words."""
    try:
        found = read_json(path)
        return f"{found['command']} (process {found['process']} on {found['host']})"
    except (InputError, KeyError):
        return "another process"
