"""Advisory locks on outputs: two commands never write into one folder, or one file, at the same time.

A lock is the operating system's, held through a file, so that a process that was killed holds nothing and what it left
is stale. Beside it, a JSON file names the process for the message that the other one prints. Both go with the lock.

A folder that grows (a run, a capture, an evaluation) is locked by files in it, a file or folder that appears as a whole
by files beside it. Only writers take locks. A folder that cannot be written needs none and gets none; where the file
system has no locks, as on some network drives, the work goes on and one line on stderr says so.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from ggavatar.errors import InputError
from ggavatar.io.held_folders import hold_folder, make_folder
from ggavatar.io.json_files import read_json
from ggavatar.text.terminal import write_err

LOCK, OWNER = ".lock", ".lock.json"
"""Names of the files of a folder's lock; those of a lock beside `NAME` are `.NAME.lock` and `.NAME.lock.json`."""

PATIENCE = 0.3
"""How long a lock is tried for, s: a holder that is just leaving has then left."""

_WITHOUT_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
"""What file systems without locks answer."""


def is_lock_file(path: Path) -> bool:
    """Whether a file belongs to a lock, and so not to what its folder holds."""
    return path.name.startswith(".") and path.name.endswith((LOCK, OWNER))


@contextmanager
def lock_folder(folder: Path, wait: bool = False) -> Iterator[None]:
    """Hold the lock of an existing folder; while it is held, a removed folder does not come back (`make_folder`).

    Args:
        folder: The folder.
        wait: Wait for another process that holds it, and say so, instead of an error.

    Raises:
        InputError: Another process holds it.
        OSError: The folder does not exist, or its lock files belong to somebody else.
    """
    with hold_folder(folder), _lock(folder / LOCK, folder / OWNER, folder, wait):
        yield


@contextmanager
def lock_output(path: Path) -> Iterator[None]:
    """Hold the lock of a file, of a folder that is replaced as a whole, or of a set of files named after it.

    Its parent folder is created if it is missing, and does not come back if it is removed while the lock is held.

    Raises:
        InputError: Another process holds it.
        OSError: The parent folder cannot be created or written.
    """
    parent = path.parent
    make_folder(parent)
    with hold_folder(parent), _lock(parent / f".{path.name}{LOCK}", parent / f".{path.name}{OWNER}", path, wait=False):
        yield


@contextmanager
def _lock(lock_path: Path, owner_path: Path, target: Path, wait: bool) -> Iterator[None]:
    """Hold a lock with these files on a target."""
    lock = FileLock(lock_path, fallback_to_soft=False)
    if not _acquire(lock, owner_path, target, wait):
        yield
        return
    try:
        _write_owner(owner_path)
        yield
    finally:
        owner_path.unlink(missing_ok=True)
        with suppress(OSError):  # Windows cannot remove an open file: there, releasing it does
            lock_path.unlink()  # before the release: afterwards it would be another process's
        lock.release()


def _acquire(lock: FileLock, owner_path: Path, target: Path, wait: bool) -> bool:
    """Acquire the lock, or return False where none can be had or is needed."""
    try:
        lock.acquire(timeout=PATIENCE)
        return True
    except Timeout as error:
        if not wait:
            raise InputError(
                f"{target}: {_owner(owner_path)} is writing here; wait until it ends, or stop it"
            ) from error
        write_err(f"waiting for {_owner(owner_path)}, which is writing into {target}")
        sys.stderr.flush()
        lock.acquire()
        return True
    except NotImplementedError:
        pass
    except OSError as error:
        folder = owner_path.parent
        if not os.access(folder, os.W_OK) and error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            return False  # nothing can be written there, so nothing can be mixed
        if error.errno not in _WITHOUT_LOCKS:
            raise
    with suppress(OSError):
        Path(lock.lock_file).unlink()
    write_err(f"note: {target}: this file system has no locks; let no other command write here meanwhile")
    return False


def _write_owner(path: Path) -> None:
    """Name this process; a note for people, so not atomic: a temporary file would be one more file to leave behind."""
    path.unlink(missing_ok=True)
    owner = {"process": os.getpid(), "host": socket.gethostname(), "command": Path(sys.argv[0]).name}
    with path.open("x", encoding="utf-8") as file:
        file.write(json.dumps(owner) + "\n")


def _owner(path: Path) -> str:
    """The process that holds a lock, in words."""
    try:
        found = read_json(path)
        words = f"{found['command']} (process {found['process']} on {found['host']})"
    except (InputError, KeyError, OSError):
        return "another process"
    return words if words.isprintable() and len(words) < 200 else "another process"  # not ours: no escapes, no lines
