"""Atomic file writes: a file appears complete or not at all."""

from __future__ import annotations

import glob
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from ggavatar.io.held_folders import make_folder, require_folder

PARTIAL_SUFFIX = ".part"
"""Suffix of the temporary files, whose names begin with a dot."""


_NAME_LENGTH = 60  # characters of up to four bytes, of the 255 bytes that a name may have
_IS_WINDOWS = os.name == "nt"
_PAUSES = (0.02, 0.1, 0.5)
"""How long an open file is waited for on Windows, s."""


def _umask() -> int:
    """The process's file mode creation mask, which POSIX can only read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


_UMASK = _umask()
"""Read once, here: threads that read it at the same time would leave it 0."""


def write_atomically(path: Path, write: Callable[[IO[bytes]], object], durable: bool = True) -> None:
    """Let `write` fill a temporary file beside `path` and rename it to `path`; on any failure the old file stays.

    Args:
        path: The file to write; its folder is created, except where that must not come back (`make_folder`).
        write: Receives the open temporary file.
        durable: Wait until the disk has the bytes, so that even a power cut leaves the old file or the new one.
    """
    make_folder(path.parent)
    try:
        _write_and_rename(path, write, durable)
    except FileNotFoundError:
        require_folder(path.parent)  # removed in this moment: say that, not the name of the temporary file
        raise


def _write_and_rename(path: Path, write: Callable[[IO[bytes]], object], durable: bool) -> None:
    prefix = f".{path.name[:_NAME_LENGTH]}."  # says whose it is, should it be left behind
    handle, name = tempfile.mkstemp(prefix=prefix, suffix=PARTIAL_SUFFIX, dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            write(stream)
            stream.flush()
            if durable:
                os.fsync(stream.fileno())
        os.chmod(name, 0o666 & ~_UMASK)
        _replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _replace(name: str, path: Path) -> None:
    """Rename; on Windows a file that another program has open for a moment is tried again."""
    for pause in _PAUSES if _IS_WINDOWS else ():
        try:
            os.replace(name, path)
            return
        except PermissionError:
            time.sleep(pause)
    os.replace(name, path)


def partial_file(path: Path) -> Path:
    """Where a file is while a library writes it that wants a name; to be renamed when it is complete."""
    return path.with_name(f".{path.name}{PARTIAL_SUFFIX}")


def is_partial(path: Path) -> bool:
    """Whether a file is a temporary one that a killed process has left behind."""
    return path.name.startswith(".") and path.suffix == PARTIAL_SUFFIX


def remove_partial_files(*folders: Path, begin: str = "") -> None:
    """Remove what killed processes have left directly in these folders.

    Args:
        folders: Where to look; they need not exist.
        begin: Only what was to become a file whose name begins so. Nobody else may be writing such files.
    """
    for folder in folders:
        for path in folder.glob(f".{glob.escape(begin)}*{PARTIAL_SUFFIX}"):
            path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) atomically."""
    write_atomically(path, lambda stream: stream.write(text.encode("utf-8")))
