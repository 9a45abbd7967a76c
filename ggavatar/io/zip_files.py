"""Zip archives of bounded size: npz, what `torch.save` writes, SOG, MediaPipe's bundles."""

from __future__ import annotations

import errno
import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO, cast

from ggavatar.errors import InputError
from ggavatar.io.regular_files import open_regular

MAX_MEMBERS = 4096
MAX_DIRECTORY_BYTES = 1 << 21
"""Largest list of members: 512 bytes for each."""

DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, ValueError, RuntimeError),
    *(NotImplementedError, OverflowError, LookupError),
)
"""What zipfile raises for damaged archives, for encrypted ones and for those of later versions."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 1


@contextmanager
def open_zip(path: Path, expected: str) -> Iterator[zipfile.ZipFile]:
    """Open an archive whose members are stored or deflated; what zipfile says of damage becomes an `InputError`.

    Args:
        path: The archive.
        expected: What it should be, for messages.

    Raises:
        InputError: Not a regular file, not a zip archive, damaged, encrypted, packed otherwise, or of more than
            `MAX_MEMBERS` members.
    """
    with open_regular(path, expected) as stream:
        bounded = _Bounded(stream)
        try:
            with _as_damage():
                archive = zipfile.ZipFile(cast(IO[bytes], bounded))
            with archive:
                bounded.is_open = True
                _check(path, archive)
                yield archive
        except (zipfile.BadZipFile, zlib.error, EOFError) as error:
            raise InputError(
                f"{path}: expected {expected}, found another file type or a damaged one ({str(error)[:100]}); copy or "
                "create the file again"
            ) from error


@contextmanager
def _as_damage() -> Iterator[None]:
    """Make whatever zipfile raises for a damaged archive a `BadZipFile`."""
    try:
        yield
    except DAMAGE as error:
        raise zipfile.BadZipFile(str(error)[:100]) from error
    except OSError as error:
        if error.errno != errno.EINVAL:  # EINVAL: a member lies before the file's start
            raise
        raise zipfile.BadZipFile("a member lies outside the file") from error


def read_zipped(archive: zipfile.ZipFile, member: zipfile.ZipInfo | str, limit: int) -> bytes:
    """The content of a member that unpacks to at most `limit` bytes, whatever the archive's list says.

    Raises:
        KeyError: There is no such member.
        zipfile.BadZipFile: It is larger, or damaged.
    """
    info = archive.getinfo(member) if isinstance(member, str) else member
    if info.file_size > limit:
        raise zipfile.BadZipFile(f"a member of {info.file_size >> 20} MiB")
    with _as_damage(), archive.open(info) as stream:
        return stream.read(info.file_size)


class _Bounded:
    """A stream for zipfile, which reads the whole list of members at once, however long the archive says it is."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self.is_open = stream, False
        self.seek, self.tell, self.seekable, self.close = stream.seek, stream.tell, stream.seekable, stream.close

    def read(self, count: int = -1) -> bytes:
        if self.is_open:
            return self._stream.read(count)
        data = self._stream.read(count if 0 <= count <= MAX_DIRECTORY_BYTES else MAX_DIRECTORY_BYTES + 1)
        if len(data) > MAX_DIRECTORY_BYTES:
            raise zipfile.BadZipFile(f"a list of members of more than {MAX_DIRECTORY_BYTES >> 20} MiB")
        return data


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    infos = archive.infolist()
    if len(infos) > MAX_MEMBERS:
        raise InputError(f"{path}: expected at most {MAX_MEMBERS} members in the archive, found {len(infos)}")
    for info in infos:
        if info.compress_type not in _METHODS or info.flag_bits & _ENCRYPTED:
            raise InputError(
                f"{path}: expected members that are stored or deflated, found {info.filename[:60]!r} packed otherwise "
                "or encrypted; save the file again"
            )
