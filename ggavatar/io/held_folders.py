"""Folders that this process is writing into: if one is removed or replaced meanwhile, no write brings it back.

The folders are those whose lock is held (`ggavatar.io.folder_lock`), so this module knows what the process holds, as
the operating system does for the locks themselves.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, eq=False)
class HeldFolder:
    """A folder as it was when this process began to write into it.

    Attributes:
        path: Absolute, without links.
        identity: Device and file number; another folder of the same name has others.
    """

    path: Path
    identity: tuple[int, int]

    def require(self) -> None:
        """Raise a `FileNotFoundError` if the folder is no longer there, or another one in its place."""
        try:
            status = self.path.stat()
            found = (status.st_dev, status.st_ino)
        except (FileNotFoundError, NotADirectoryError):
            found = None
        if found != self.identity:
            raise _removed(self.path)


_held: list[HeldFolder] = []


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """While active, `make_folder` creates nothing in this folder once it was removed, renamed or replaced.

    Raises:
        FileNotFoundError: There is no such folder.
    """
    require_folder(folder)
    status = folder.stat()
    held = HeldFolder(_absolute(folder), (status.st_dev, status.st_ino))
    _held.append(held)
    try:
        yield
    finally:
        _held.remove(held)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents, but never a held folder, nor anything in one that is gone.

    Raises:
        FileNotFoundError: A held folder that should contain it was removed, renamed or replaced.
        OSError: It cannot be created.
    """
    path = _absolute(folder)
    roots = [held for held in tuple(_held) if path.is_relative_to(held.path)]
    for held in roots:
        held.require()
    if path.is_dir():
        return
    if not roots:
        path.mkdir(parents=True, exist_ok=True)
        return
    part = max((held.path for held in roots), key=lambda root: len(root.parts))
    for name in path.relative_to(part).parts:  # one by one: with `parents`, the root itself could come back
        part = part / name
        part.mkdir(exist_ok=True)


def require_folder(folder: Path) -> None:
    """Raise a `FileNotFoundError` if a folder that a command has been writing into is gone: it does not come back."""
    if not folder.is_dir():
        raise _removed(folder)


def _removed(folder: Path) -> FileNotFoundError:
    return FileNotFoundError(errno.ENOENT, "the folder was removed or renamed while it was written", str(folder))


def _absolute(folder: Path) -> Path:
    return Path(os.path.realpath(folder))
