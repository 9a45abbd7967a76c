"""PLY files of numbers, as Gaussian splats use: ASCII or binary of either byte order, one table after another.

Files are written with plyfile but not read with it: it offers no way to check the header before the data are read. A
74-byte file that announces two billion lists kept plyfile 1.1 busy for 208 s, and 20 MB without a line break for 12 s.
Here the header is bounded, the size it implies is compared with the size of the file before anything is allocated, and
columns are copied out of a memory map one by one.

Read as writers write them: lines end in LF, CR LF or CR, comments hold any bytes, elements that nobody asked for and
bytes behind the last one are passed over.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np
from numpy import ndarray
from plyfile import PlyData, PlyElement

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from ggavatar.io.regular_files import open_regular

MAX_HEADER_BYTES, MAX_ELEMENTS, MAX_PROPERTIES, MAX_ROWS = 1 << 20, 64, 512, 50_000_000
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_ODD_NAN = re.compile(rb"[-+]?(?:nan\([^\s)]*\)|1\.#[A-Za-z]+)", re.IGNORECASE)
"""NaN as the C libraries of Windows print it: `-nan(ind)`, `1.#QNAN`."""
_ADVICE = "save it as binary little-endian PLY of 3D Gaussians"


@dataclass(frozen=True)
class Element:
    """One table of a file.

    Attributes:
        name: Its name.
        count: Number of rows.
        properties: Type of every column by name, in order, without byte order; lists are left out.
        has_lists: Whether rows hold lists too, so that their sizes differ.
    """

    name: str
    count: int
    properties: dict[str, str] = field(default_factory=dict)
    has_lists: bool = False


@dataclass(frozen=True)
class Header:
    """The header of a file.

    Attributes:
        byte_order: `<` or `>` of a binary file, `=` of ASCII.
        elements: Its tables by name, in order.
        comments: Texts of the comment lines; bytes that are not UTF-8 are replaced.
        size: Size of the header, bytes.
    """

    byte_order: str
    elements: Mapping[str, Element]
    comments: tuple[str, ...]
    size: int

    @property
    def is_ascii(self) -> bool:
        """Whether the numbers are written as text."""
        return self.byte_order == "="

    def row(self, name: str) -> np.dtype:
        """Data type of one row of an element without lists."""
        columns = self.elements[name].properties.items()
        return np.dtype([(column, self.byte_order + kind) for column, kind in columns])


def read_header(path: Path) -> Header:
    """Read and check the header of a PLY file.

    Raises:
        InputError: The file is not a PLY file, has an unknown encoding or layout, or too large a table.
    """
    with open_regular(path, "a PLY file") as stream:
        lines, size = _lines(path, stream)
    words = lines[1].split() if len(lines) > 1 else []
    if len(words) != 3 or words[0] != "format" or words[1] not in _BYTE_ORDERS or words[2] != "1.0":
        found = repr(lines[1][:60]) if len(lines) > 1 else "no such line"
        raise InputError(
            f"{path}: expected 'format' and ascii, binary_little_endian or binary_big_endian 1.0, found {found}; "
            f"{_ADVICE}"
        )
    body = [line.split() for line in lines[2:] if line.strip() and not line.startswith(("comment", "obj_info"))]
    comments = tuple(_text(line[8:]) for line in lines[2:] if line.startswith("comment "))
    return Header(_BYTE_ORDERS[words[1]], _elements(path, body), comments, size)


def _text(line: str) -> str:
    return line.encode("latin-1").decode("utf-8", errors="replace")


def _lines(path: Path, stream: IO[bytes]) -> tuple[list[str], int]:
    """Lines of the header without `end_header`, decoded as Latin-1, and its size in bytes."""
    text = stream.read(MAX_HEADER_BYTES)
    first = re.match(rb"ply[ \t]*(?:\r?\n|(\r))", text)
    # A header ends its last line as its first; where that is a lone CR, a byte 10 behind it belongs to the data.
    newline, ending = (b"\r", rb"\rend_header[ \t]*\r") if first and first[1] else (b"\n", rb"\nend_header[ \t]*\r?\n")
    end = re.search(ending, text) if first else None
    if end is None:
        raise InputError(f"{path}: expected a PLY file ('ply' to 'end_header'), found another file; {_ADVICE}")
    return [line.decode("latin-1").rstrip("\r \t") for line in text[: end.start()].split(newline)], end.end()


def _elements(path: Path, lines: Sequence[Sequence[str]]) -> dict[str, Element]:
    found: dict[str, Element] = {}
    current: Element | None = None
    for words in lines:
        if words[0] == "element":
            current = _element(path, words)
            if current.name in found or len(found) >= MAX_ELEMENTS:
                raise InputError(f"{path}: expected up to {MAX_ELEMENTS} elements, each name once; {_ADVICE}")
            found[current.name] = current
        elif current is not None and words[0] == "property" and words[1:2] == ["list"]:
            current = found[current.name] = Element(current.name, current.count, current.properties, has_lists=True)
        elif current is None or not _is_property(words) or words[2] in current.properties:
            raise InputError(
                f"{path}: expected lines such as 'property float x', each name once, found {' '.join(words)[:60]!r}; "
                f"{_ADVICE}"
            )
        else:
            current.properties[words[2]] = _TYPES[words[1]]
            if len(current.properties) > MAX_PROPERTIES:
                raise InputError(f"{path}: expected up to {MAX_PROPERTIES} properties, found more; {_ADVICE}")
    return found


def _is_property(words: Sequence[str]) -> bool:
    return len(words) == 3 and words[0] == "property" and words[1] in _TYPES


def _element(path: Path, words: Sequence[str]) -> Element:
    if len(words) != 3 or not (words[2].isascii() and words[2].isdigit() and len(words[2]) < 16):
        raise InputError(f"{path}: expected 'element NAME COUNT', found {' '.join(words)[:60]!r}; {_ADVICE}")
    return Element(words[1], int(words[2]))


def read_table(path: Path, header: Header, name: str) -> ndarray:
    """One element as a structured array of its own types; of a binary file a memory map.

    Raises:
        InputError: There is no such element, it holds lists, is too large, or the file is shorter than it.
    """
    element = header.elements.get(name)
    if element is None or not element.properties or element.has_lists:
        has = "with lists" if element is not None and element.has_lists else "without numbers" if element else "none"
        known = ", ".join(header.elements) or "none"
        raise InputError(f"{path}: expected an element {name!r} of numbers, found {has} (elements: {known}); {_ADVICE}")
    if not 1 <= element.count <= MAX_ROWS:
        raise InputError(f"{path}: expected 1 to {MAX_ROWS} rows in {name!r}, found {element.count}")
    before = list(header.elements.values())[: list(header.elements).index(name)]
    if header.is_ascii:
        return _read_text(path, header, element, sum(other.count for other in before))
    if any(other.has_lists for other in before):
        raise InputError(f"{path}: expected the element {name!r} before those with lists; {_ADVICE}")
    start = header.size + sum(other.count * header.row(other.name).itemsize for other in before)
    _check_size(path, element, start + element.count * header.row(name).itemsize)
    return np.memmap(path, header.row(name), "r", offset=start, shape=(element.count,))


def trailing_bytes(path: Path, header: Header) -> int:
    """Bytes behind the last element of a binary file; 0 where its end is not known without reading it."""
    if header.is_ascii or any(element.has_lists for element in header.elements.values()):
        return 0
    size = sum(element.count * header.row(element.name).itemsize for element in header.elements.values())
    return max(path.stat().st_size - header.size - size, 0)


def _check_size(path: Path, element: Element, expected: int) -> None:
    """Raise an `InputError` if a file ends before an element does."""
    actual = path.stat().st_size
    if actual < expected:
        raise InputError(
            f"{path}: expected {expected} bytes for {element.count} rows of {element.name!r}, found {actual}; the file "
            "is truncated or damaged, copy it again"
        )


def _read_text(path: Path, header: Header, element: Element, rows_before: int) -> ndarray:
    """Rows of an ASCII file, one a line, after those of earlier elements."""
    width = len(element.properties)
    _check_size(path, element, header.size + rows_before + element.count * 2 * width - 1)
    with open_regular(path, "a PLY file") as stream:
        stream.seek(header.size)
        lines = itertools.islice(_number_lines(stream), rows_before, rows_before + element.count)
        first = next(lines, None)
        try:
            # Without a line, loadtxt would warn.
            row, found = header.row(element.name), () if first is None else itertools.chain((first,), lines)
            table = np.loadtxt(found, row, comments=None, encoding="ascii", ndmin=1) if found else np.empty(0, row)
        except (ValueError, OverflowError) as error:
            raise InputError(
                f"{path}: expected lines of {width} numbers for {element.name!r}, found others ({error}); {_ADVICE}"
            ) from error
    if len(table) != element.count:
        raise InputError(
            f"{path}: expected {element.count} rows of {element.name!r}, found {len(table)}; the file is truncated or "
            "damaged, copy it again"
        )
    return table


def _number_lines(stream: IO[bytes]) -> Iterator[bytes]:
    """Lines that are not blank, NaN spelled as everywhere else."""
    for line in stream:
        if line.strip():
            yield _ODD_NAN.sub(b"nan", line) if b"(" in line or b"#" in line else line


def read_columns(path: Path, table: ndarray, names: Sequence[str]) -> ndarray:
    """Columns of a table as one float32 array [N, len(names)]; NaN and infinity stay what they are.

    Raises:
        InputError: A column is missing.
    """
    missing = [name for name in names if name not in (table.dtype.names or ())]
    if missing:
        raise InputError(
            f"{path}: expected the properties of 3D Gaussians, found no {', '.join(missing[:8])}; {_ADVICE}"
        )
    columns = np.empty((len(table), len(names)), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for index, name in enumerate(names):
            columns[:, index] = table[name]
    return columns


def write_columns(path: Path, columns: Mapping[str, ndarray], comments: Sequence[str] = ()) -> None:
    """Write columns [N] as float32 in the given order; the file appears complete or not at all."""
    table = np.empty(len(next(iter(columns.values()))), [(name, "<f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    document = PlyData([PlyElement.describe(table, "vertex")], byte_order="<", comments=list(comments))
    write_atomically(path, document.write)
