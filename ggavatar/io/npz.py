"""Reading and writing npz archives of plain arrays: no pickles, sizes checked before allocation, atomic writes.

`numpy.load` is not used: it allocates whatever shape an array header claims.
"""

from __future__ import annotations

import io
import tokenize
import zipfile
from collections.abc import Collection, Mapping
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from ggavatar.io.regular_files import read_file
from ggavatar.io.zip_files import DAMAGE, open_zip

MAX_ARCHIVE_BYTES = 1 << 29
"""Largest sum of uncompressed arrays that is read from one archive (512 MiB).

A FLAME model takes 100 MB, an hour of tracking 50 MB.
"""

MALFORMED = (
    *DAMAGE,
    *(TypeError, OSError, SyntaxError, MemoryError, AttributeError, ArithmeticError, AssertionError),
    tokenize.TokenError,
)
"""What numpy and zipfile raise for damaged data; a header of an old npy file may even fail as Python's tokens."""

_EXPECTED, _PLAIN, _MAX_AXES = "an npz file", "biufcSU", 32


class ArrayHeader(NamedTuple):
    """Shape and type of a stored array, known before any of it is read."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def npz_headers(path: Path) -> dict[str, ArrayHeader]:
    """Shapes and types of all arrays in an npz file.

    Raises:
        InputError: The file is not an npz archive, or claims more than `MAX_ARCHIVE_BYTES`.
    """
    with open_zip(path, _EXPECTED) as archive:
        return {name: header for name, header, _ in _members(path, archive)}


def read_npz(path: Path, names: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """Read arrays from an npz file without ever unpickling.

    Args:
        path: The file.
        names: Arrays to read; absent ones are left out. None reads all.

    Returns:
        Arrays by name, each owning its memory.

    Raises:
        InputError: The file is not a zip, is damaged, holds Python objects, or unpacks to more than
            `MAX_ARCHIVE_BYTES`.
    """
    arrays = {}
    with open_zip(path, _EXPECTED) as archive:
        for name, header, info in _members(path, archive):
            if names is None or name in names:
                arrays[name] = _read_member(path, archive, name, header, info)
    return arrays


def read_npy(path: Path, max_bytes: int) -> np.ndarray:
    """Read an npy file without ever unpickling.

    Raises:
        InputError: No such file, larger than `max_bytes`, damaged, or it holds Python objects.
    """
    content = read_file(path, max_bytes, "an npy file")
    stream, size = io.BytesIO(content), len(content)
    try:
        shape, dtype = _read_header(stream)
        if not _is_plain(dtype) or prod(shape) * max(dtype.itemsize, 1) > size:
            raise ValueError(f"shape {shape!s:.80}" if _is_plain(dtype) else "Python objects, records or dates")
        stream.seek(0)
        return npy.read_array(stream, allow_pickle=False, max_header_size=10_000)
    except MALFORMED as error:
        raise InputError(f"{path}: expected an array of numbers ({_words(error)}); create the file again") from error


def _is_plain(dtype: np.dtype[Any]) -> bool:
    """Whether a type is of numbers or texts: no objects, records or dates."""
    return not dtype.hasobject and dtype.kind in _PLAIN


def _words(error: BaseException) -> str:
    """The beginning of a message of numpy, which may quote a whole header."""
    return str(error)[:120] or type(error).__name__


def _read_member(
    path: Path, archive: zipfile.ZipFile, name: str, header: ArrayHeader, info: zipfile.ZipInfo
) -> np.ndarray:
    try:
        with archive.open(info) as stream:
            array = npy.read_array(stream, allow_pickle=False, max_header_size=10_000)
    except MALFORMED as error:
        raise InputError(
            f"{path}: array {name!r:.80} cannot be read ({_words(error)}); create the file again"
        ) from error
    if array.shape != header.shape:
        raise InputError(f"{path}: array {name!r:.80} changed its shape while it was read; create the file again")
    return array


def _members(path: Path, archive: zipfile.ZipFile) -> list[tuple[str, ArrayHeader, zipfile.ZipInfo]]:
    """Names, headers and entries of the arrays, after checking their sizes."""
    infos = archive.infolist()
    claimed = sum(info.file_size for info in infos)
    if claimed > MAX_ARCHIVE_BYTES:
        raise InputError(
            f"{path}: unpacks to {claimed >> 20} MiB, the limit is {MAX_ARCHIVE_BYTES >> 20} MiB; the file is "
            "damaged or hostile"
        )
    return [(info.filename.removesuffix(".npy"), _header(path, archive, info), info) for info in infos]


def _header(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> ArrayHeader:
    try:
        with archive.open(info) as stream:
            shape, dtype = _read_header(stream)
    except MALFORMED as error:
        raise InputError(
            f"{path}: entry {info.filename!r:.80} is not an array ({_words(error)}); create the file again"
        ) from error
    if not _is_plain(dtype):
        raise InputError(
            f"{path}: array {info.filename!r:.80} holds Python objects (which could run code), records or dates; only "
            "plain numbers and text are read"
        )
    if prod(shape) * max(dtype.itemsize, 1) > info.file_size:  # texts of no characters are counted too
        raise InputError(
            f"{path}: array {info.filename!r:.80} claims shape {shape!s:.80} but holds {info.file_size} bytes; the "
            "file is damaged"
        )
    return ArrayHeader(tuple(shape), dtype)


def _read_header(stream: IO[bytes] | io.BufferedIOBase) -> ArrayHeader:
    """Shape and type at the start of an npy stream; any of `MALFORMED` if there is no such header."""
    version = npy.read_magic(stream)
    reader = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
    if reader is None:
        raise ValueError(f"npy version {version}")
    shape, _, dtype = reader(stream, max_header_size=10_000)
    if len(shape) > _MAX_AXES or any(type(size) is not int or size < 0 for size in shape):
        raise ValueError(f"shape {shape}")
    return ArrayHeader(tuple(shape), dtype)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays atomically; the same arrays give the same bytes."""
    for name, array in arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise ValueError(f"expected plain numbers or text for {name!r}, got dtype object")
    write_atomically(path, lambda stream: _write_members(stream, arrays))


def _write_members(stream: IO[bytes], arrays: Mapping[str, np.ndarray]) -> None:
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                npy.write_array(member, np.asanyarray(array), allow_pickle=False)
