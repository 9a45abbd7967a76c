"""The one way in for files that a user names: regular files only, of bounded size.

A pipe or a device has no end and no size, so that a reader waits for it forever or fills the memory. What a path is is
asked before it is opened, since opening a pipe already waits, and again of the opened file, which nobody can exchange.
`tests/test_safe_reading.py` checks that nothing else opens files.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError

_FLAGS = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
_NO_FILE = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG)


def open_regular(path: Path, expected: str = "a file") -> io.BufferedReader:
    """Open a regular file for reading, in binary.

    Args:
        path: The file; links are followed.
        expected: What it should be, for the message.

    Raises:
        InputError: No such file, or a folder, pipe, socket or device; also from the stream, where the disk fails.
        OSError: It may not be read.
    """
    try:
        _require_regular(path, expected, os.stat(path))
        handle = os.open(path, _FLAGS)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError) or (isinstance(error, OSError) and error.errno not in _NO_FILE):
            raise
        raise InputError(f"{path}: no such file") from error  # a ValueError is a name with a zero byte
    try:
        _require_regular(path, expected, os.fstat(handle))
        return io.BufferedReader(_Content(handle, path), 1 << 16)
    except BaseException:
        os.close(handle)
        raise


class _Content(io.FileIO):
    """The bytes of an opened file; what cannot be read is an `InputError` that names it.

    Disks fail, and the files of /proc are regular by name, but have no end or block.
    """

    def __init__(self, handle: int, path: Path) -> None:
        super().__init__(handle, "rb")
        self._path = path

    def readinto(self, buffer: Any) -> int:
        return self._read(lambda: super(_Content, self).readinto(buffer))

    def readall(self) -> bytes:
        return self._read(super().readall)

    def _read(self, read: Callable[[], Any]) -> Any:
        try:
            found = read()
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror}); copy it again") from error
        if found is None:
            raise InputError(f"{self._path}: expected a file with an end, found one that waits for more; give a copy")
        return found


def read_file(path: Path, limit: int, expected: str = "a file") -> bytes:
    """The content of a regular file of at most `limit` bytes.

    Raises:
        InputError: As `open_regular`, or the file is larger than `limit`, or the disk fails.
        OSError: It may not be read.
    """
    with open_regular(path, expected) as stream:
        size = os.fstat(stream.fileno()).st_size
        content = b"" if size > limit else stream.read(limit + 1)
    if size > limit or len(content) > limit:
        raise InputError(
            f"{path}: expected {expected} of at most {_size(limit)}, found {_size(max(size, len(content)))}"
        )
    return content


def read_start(path: Path, count: int) -> bytes:
    """The first `count` bytes of a regular file, or fewer if it is shorter: enough to tell what it is.

    Raises:
        InputError: As `open_regular`.
    """
    with open_regular(path) as stream:
        return stream.read(count)


def regular_size(path: Path, expected: str = "a file", limit: int | None = None) -> int:
    """The size of a regular file, bytes, before a library that wants a path opens it.

    Raises:
        InputError: As `open_regular`, or the file is larger than `limit`.
    """
    with open_regular(path, expected) as stream:
        size = os.fstat(stream.fileno()).st_size
    if limit is not None and size > limit:
        raise InputError(f"{path}: expected {expected} of at most {_size(limit)}, found {_size(size)}")
    return size


_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe; write what comes out of it into a file and give that"),
    (stat.S_ISSOCK, "a socket; give a file"),
    (stat.S_ISCHR, "a device; give a file"),
    (stat.S_ISBLK, "a device; give a file"),
)


def _require_regular(path: Path, expected: str, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        found = next((words for test, words in _KINDS if test(status.st_mode)), "something else; give a file")
        raise InputError(f"{path}: expected {expected}, found {found}")


def _size(count: int) -> str:
    """A number of bytes in words; KiB and MiB are rounded up."""
    if count < 10 << 10:
        return f"{count} bytes"
    return f"{-(-count >> 10)} KiB" if count < 10 << 20 else f"{-(-count >> 20)} MiB"
