"""The files of a SOG (PlayCanvas): `meta.json` and lossless images, in a folder or in one zip archive, size-checked."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.file_kinds import SOG_LEVELS, SOG_META, ZIP_MAGIC
from ggavatar.formats.splats.ply import MAX_ROWS
from ggavatar.io.json_files import MAX_JSON_BYTES, parse_json, read_json
from ggavatar.io.picture_bytes import pixels_only
from ggavatar.io.regular_files import read_file, read_start
from ggavatar.io.zip_files import open_zip, read_zipped

MAX_IMAGE_BYTES = 1 << 29
LARGE_IMAGE, MAX_RATIO = 1 << 20, 50
"""An image of more pixels that is packed better than this was made to fill the memory; Gaussians pack three times."""
_ADVICE, _EXPECTED = "export it again", "a SOG (a zip archive)"


class SogFiles(NamedTuple):
    """An opened SOG.

    Attributes:
        path: The archive, or the meta.json.
        meta: The content of its meta.json.
        read: Bytes of one of the other files, by the name that meta.json gives it.
    """

    path: Path
    meta: dict[str, Any]
    read: Callable[[str], bytes]


def meta_file(path: Path) -> Path:
    """The meta.json that an argument names: itself, or the one in a folder."""
    return path / SOG_META if path.is_dir() else path


def open_sog(path: Path) -> SogFiles:
    """Open a SOG: a zip archive, a folder, or its meta.json.

    Raises:
        InputError: Not an archive or JSON, without a meta.json, or its parts are too large.
    """
    path = meta_file(path)
    if path.name == SOG_LEVELS:
        raise InputError(f"{path}: expected one SOG, found a list of several levels of detail; open one of its folders")
    if read_start(path, 4) != ZIP_MAGIC:
        return SogFiles(path, read_json(path), lambda name: _read_beside(path, name))
    home = _meta_in_zip(path)
    meta = parse_json(path, _read_zipped(path, str(home), MAX_JSON_BYTES))
    return SogFiles(path, meta, lambda name: _read_zipped(path, str(home.parent / name)))


def _meta_in_zip(path: Path) -> PurePosixPath:
    """The topmost meta.json of an archive."""
    with open_zip(path, _EXPECTED) as archive:
        found = [PurePosixPath(name) for name in archive.namelist() if PurePosixPath(name).name == SOG_META]
    if not found:
        raise InputError(f"{path}: expected a SOG (a zip archive with {SOG_META}), found none in it")
    return min(found, key=lambda name: len(name.parts))


def _read_zipped(path: Path, name: str, limit: int = MAX_IMAGE_BYTES) -> bytes:
    with open_zip(path, _EXPECTED) as archive:
        if name not in archive.namelist():
            raise InputError(f"{path}: expected {_short(name)} in the archive, found none; {_ADVICE}")
        return read_zipped(archive, name, limit)


def _short(text: object) -> str:
    """At most 100 characters of a name in an archive, or of a message that holds one."""
    return str(text)[:100]


def _read_beside(path: Path, name: str) -> bytes:
    beside = path.parent / name
    if not beside.is_file():
        raise InputError(f"{path}: expected {name} beside it, found no such file; copy the whole folder")
    return read_file(beside, MAX_IMAGE_BYTES, "an image of a SOG")


def read_image(files: SogFiles, name: str, pixels: tuple[int, int]) -> UInt8[ndarray, "H W 4"]:
    """An image as straight RGBA; without an alpha channel, alpha is 255.

    Args:
        files: The opened SOG.
        name: Its name in meta.json.
        pixels: Smallest and largest number of pixels; checked before it is decoded.

    Raises:
        InputError: Neither WebP nor PNG, damaged, not 8-bit, or of another size.
    """
    import cv2

    data = files.read(name)
    size = _image_size(data)
    if size is None:
        raise InputError(f"{files.path}: expected {name} as WebP or PNG, found another file; {_ADVICE}")
    count = size[0] * size[1]
    if not pixels[0] <= count <= min(pixels[1], 2 * MAX_ROWS):
        raise InputError(
            f"{files.path}: expected {name} with {pixels[0]} to {pixels[1]} pixels, found {size[0]}×{size[1]}; "
            f"{_ADVICE}"
        )
    if count > LARGE_IMAGE and 4 * count > MAX_RATIO * len(data):
        raise InputError(f"{files.path}: {name} is too small for {size[0]}×{size[1]} pixels, so it is damaged")
    try:
        image = cv2.imdecode(np.frombuffer(pixels_only(data), np.uint8), cv2.IMREAD_UNCHANGED)
    except ValueError:
        image = None
    if image is None or image.dtype != np.uint8 or image.shape[:2] != size[::-1]:
        raise InputError(f"{files.path}: {name} is damaged or not 8-bit and cannot be decoded; copy it again")
    channels = 1 if image.ndim == 2 else image.shape[2]
    code = {1: cv2.COLOR_GRAY2RGBA, 3: cv2.COLOR_BGR2RGBA, 4: cv2.COLOR_BGRA2RGBA}[channels]
    return cv2.cvtColor(image, code)


def _image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that the header of a PNG or WebP file states; None for other files."""
    kind, width, height = data[12:16], 0, 0
    if len(data) < 30:
        return None
    if data.startswith(b"\x89PNG\r\n\x1a\n") and kind == b"IHDR":
        width, height = struct.unpack_from(">II", data, 16)
    elif data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return None
    elif kind == b"VP8X":
        width, height = (int.from_bytes(data[start : start + 3], "little") + 1 for start in (24, 27))
    elif kind == b"VP8L":
        word = int.from_bytes(data[21:25], "little")
        width, height = (word & 0x3FFF) + 1, (word >> 14 & 0x3FFF) + 1
    elif kind == b"VP8 ":
        width, height = (value & 0x3FFF for value in struct.unpack_from("<HH", data, 26))
    return width, height
