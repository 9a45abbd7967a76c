"""Atomic file writes: a file appears complete or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

PARTIAL_SUFFIX = ".part"
"""Suffix of the temporary files, whose names begin with a dot."""


def write_atomically(path: Path, write: Callable[[IO[bytes]], object], durable: bool = True) -> None:
    """Let `write` fill a temporary file beside `path` and rename it to `path`; on any failure the old file stays.

    Args:
        path: The file to write; its folder is created. Where that must not happen, call `require_folder` first.
        write: Receives the open temporary file.
        durable: Wait until the disk has the bytes, so that even a power cut leaves the old file or the new one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".", suffix=path.suffix + PARTIAL_SUFFIX, dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            write(stream)
            stream.flush()
            if durable:
                os.fsync(stream.fileno())
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def require_folder(folder: Path) -> None:
    """Raise a `FileNotFoundError` if a folder that a command has been writing into is gone: it does not come back."""
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, "the folder was removed or renamed while it was written", str(folder))


def is_partial(path: Path) -> bool:
    """Whether a file is a temporary one that a killed `write_atomically` has left behind."""
    return path.name.startswith(".") and path.suffix == PARTIAL_SUFFIX


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) atomically."""
    write_atomically(path, lambda stream: stream.write(text.encode("utf-8")))


def _umask() -> int:
    """The process's file mode creation mask, which POSIX can only read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
