"""Binary PLY files with one table of numbers, as Gaussian splats use: little-endian, one element `vertex`, no lists.

Files are written with plyfile but not read with it: it offers no way to check the header before the data are read. A
74-byte file that announces two billion lists kept plyfile 1.1 busy for 208 s, and 20 MB without a line break for 12 s.
Here the header is bounded, the size it implies is compared with the size of the file before anything is allocated, and
columns are copied out of a memory map one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy import ndarray
from plyfile import PlyData, PlyElement

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically

MAX_HEADER_BYTES, MAX_PROPERTIES, MAX_ROWS = 1 << 16, 512, 50_000_000
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2",
    "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4",
    "double": "<f8", "float64": "<f8",
}  # fmt: skip
_ADVICE = "save it as binary little-endian PLY of 3D Gaussians"


@dataclass(frozen=True)
class Header:
    """The header of a file.

    Attributes:
        count: Number of rows of the table.
        properties: Type of every column by name, in order.
        comments: Texts of the comment lines.
        size: Size of the header, bytes.
    """

    count: int
    properties: Mapping[str, str]
    comments: tuple[str, ...]
    size: int

    @property
    def row(self) -> np.dtype:
        """Data type of one row."""
        return np.dtype(list(self.properties.items()))


def read_header(path: Path) -> Header:
    """Read and check the header of a PLY file.

    Raises:
        InputError: The file is not a PLY file, has another encoding or layout, or another size than its header implies.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a PLY file, found {'a folder' if path.is_dir() else 'no such file'}")
    with path.open("rb") as stream:
        lines, size = _lines(path, stream)
    if lines[1:2] != ["format binary_little_endian 1.0"]:
        found = repr(lines[1][:60]) if len(lines) > 1 else "no such line"
        raise InputError(f"{path}: expected 'format binary_little_endian 1.0', found {found}; {_ADVICE}")
    body = [line for line in lines[2:] if not line.startswith(("comment", "obj_info"))]
    comments = tuple(line[8:] for line in lines[2:] if line.startswith("comment "))
    header = Header(_count(path, body), _properties(path, body[1:]), comments, size)
    expected_size, actual_size = size + header.count * header.row.itemsize, path.stat().st_size
    if expected_size != actual_size:
        raise InputError(
            f"{path}: expected {expected_size} bytes for {header.count} rows, found {actual_size}; the file is "
            "truncated or damaged, copy it again"
        )
    return header


def _lines(path: Path, stream: IO[bytes]) -> tuple[list[str], int]:
    """Lines of the header without `end_header`, and its size in bytes."""
    text = stream.read(MAX_HEADER_BYTES)
    end = text.find(b"\nend_header\n")
    if not text.startswith(b"ply\n") or end < 0:
        raise InputError(f"{path}: expected a PLY file ('ply' to 'end_header'), found another file; {_ADVICE}")
    try:
        return text[:end].decode("ascii").split("\n"), end + len(b"\nend_header\n")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: expected ASCII text in the header, found other bytes ({error}); {_ADVICE}"
        ) from error


def _count(path: Path, body: Sequence[str]) -> int:
    words = body[0].split(" ") if body else []
    if words[:2] != ["element", "vertex"] or len(words) != 3 or not (words[2].isdigit() and len(words[2]) < 12):
        compressed = " (compressed PLY: convert it with splat-transform)" if words[1:2] == ["chunk"] else ""
        raise InputError(
            f"{path}: expected 'element vertex N' first, found {' '.join(words)[:60]!r}{compressed}; {_ADVICE}"
        )
    if not 1 <= int(words[2]) <= MAX_ROWS:
        raise InputError(f"{path}: expected 1 to {MAX_ROWS} Gaussians, found {words[2]}")
    return int(words[2])


def _properties(path: Path, lines: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for line in lines:
        words = line.split(" ")
        if len(words) != 3 or words[0] != "property" or words[1] not in _TYPES or not words[2] or words[2] in found:
            raise InputError(
                f"{path}: expected lines such as 'property float x', each name once, found {line[:60]!r}; {_ADVICE}"
            )
        found[words[2]] = _TYPES[words[1]]
    if not 1 <= len(found) <= MAX_PROPERTIES:
        raise InputError(f"{path}: expected 1 to {MAX_PROPERTIES} properties, found {len(found)}; {_ADVICE}")
    return found


def read_columns(path: Path, header: Header, names: Sequence[str], infinite: bool = False) -> ndarray:
    """Columns as one float32 array [N, len(names)].

    Args:
        path: The file.
        header: Its header.
        names: Names of the columns.
        infinite: Whether infinities are valid, as for logits.

    Raises:
        InputError: A column is missing, or holds NaN or infinity.
    """
    missing = [name for name in names if name not in header.properties]
    if missing:
        raise InputError(
            f"{path}: expected the properties of 3D Gaussians, found no {', '.join(missing[:8])}; {_ADVICE}"
        )
    table = np.memmap(path, header.row, "r", offset=header.size, shape=(header.count,))
    columns = np.empty((header.count, len(names)), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for index, name in enumerate(names):
            columns[:, index] = table[name]
    broken = (np.isnan(columns) if infinite else ~np.isfinite(columns)).any(axis=1)
    if broken.any():
        raise InputError(
            f"{path}: expected finite numbers, found NaN or infinity in {int(broken.sum())} of {len(columns)} "
            f"Gaussians (first in row {int(broken.argmax())}, in one of {', '.join(names)}); export the file again"
        )
    return columns


def write_columns(path: Path, columns: Mapping[str, ndarray], comments: Sequence[str] = ()) -> None:
    """Write columns [N] as float32 in the given order; the file appears complete or not at all."""
    table = np.empty(len(next(iter(columns.values()))), [(name, "<f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    document = PlyData([PlyElement.describe(table, "vertex")], byte_order="<", comments=list(comments))
    write_atomically(path, document.write)
