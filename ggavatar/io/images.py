"""Reading and writing PNG and JPEG files.

Sizes are taken from the header, so nothing large is allocated for a hostile file.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically

MAX_PIXELS = 34_000_000
"""Largest picture that is decoded (34 megapixels); 8K video has 33.2."""

LARGEST_RATIO = 1100
"""No picture unpacks to more times its file size than this (deflate reaches 1032).

A file that claims more is damaged.
"""

_ONE_FILTER = (19, 32)
"""IMWRITE_PNG_FILTER = UP: files 3 % larger than with the best filter for each row, written and read a third faster.

In numbers, since OpenCV knows the names from 4.12 on; before, it took one filter anyway.
"""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_JPEG_FRAMES = frozenset({0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})


class ImageHeader(NamedTuple):
    """What a picture's first bytes say about it."""

    width: int
    height: int
    channels: int
    bit_depth: int


def image_header(path: Path) -> ImageHeader:
    """Size, channels and bit depth of a PNG or JPEG file, from its header alone.

    Raises:
        InputError: No such file, neither PNG nor JPEG, damaged, empty or larger than `MAX_PIXELS`.
    """
    try:
        with path.open("rb") as stream:
            header = _parse(stream)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: expected a picture, found a folder") from error
    except struct.error as error:
        raise InputError(f"{path}: the picture's header is cut off; copy or make the file again") from error
    if header is None:
        raise InputError(f"{path}: expected a PNG or JPEG picture, found something else")
    if header.width < 1 or header.height < 1 or header.width * header.height > MAX_PIXELS:
        raise InputError(
            f"{path}: a picture of {header.width}×{header.height} px; from 1 px to {MAX_PIXELS // 1_000_000} "
            "megapixels "
            "are read"
        )
    unpacked = header.width * header.height * header.channels * header.bit_depth // 8
    if unpacked > LARGEST_RATIO * (path.stat().st_size + 100):
        raise InputError(f"{path}: far too small for {header.width}×{header.height} px; the picture is damaged")
    return header


def _parse(stream: IO[bytes]) -> ImageHeader | None:
    start = stream.read(8)
    if start == _PNG_SIGNATURE:
        length, kind, width, height, depth, color = struct.unpack(">I4sIIBB", stream.read(18))
        valid = kind == b"IHDR" and length == 13 and color in _PNG_CHANNELS
        return ImageHeader(width, height, _PNG_CHANNELS[color], depth) if valid else None
    if start[:2] == b"\xff\xd8":
        stream.seek(2)
        return _parse_jpeg(stream)
    return None


def _parse_jpeg(stream: IO[bytes]) -> ImageHeader | None:
    """Walk the segments of a JPEG file to its frame header."""
    for _ in range(1000):
        (marker,) = struct.unpack(">H", stream.read(2))
        if marker == 0xFFFF:
            stream.seek(-1, 1)
            continue
        if marker >> 8 != 0xFF:
            return None
        (length,) = struct.unpack(">H", stream.read(2))
        if marker & 0xFF in _JPEG_FRAMES:
            depth, height, width, channels = struct.unpack(">BHHB", stream.read(6))
            return ImageHeader(width, height, channels, depth)
        stream.seek(length - 2, 1)
    return None


def read_rgb(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    """A picture as 8-bit sRGB; gray is repeated, 16 bits are reduced, transparency is dropped."""
    return _decode(path, color=True)


def read_gray(path: Path) -> UInt8[np.ndarray, "H W"]:
    """A mask as 8-bit gray: the alpha channel where there is one, else the luminance."""
    import cv2

    header = image_header(path)
    if header.channels in (2, 4):
        picture = cv2.imdecode(_contents(path), cv2.IMREAD_UNCHANGED)
        if picture is not None and picture.ndim == 3:
            return _eight_bits(picture[..., -1])
    return _decode(path, color=False)


def _decode(path: Path, color: bool) -> np.ndarray:
    import cv2

    header = image_header(path)
    flags = (cv2.IMREAD_COLOR if color else cv2.IMREAD_GRAYSCALE) | cv2.IMREAD_IGNORE_ORIENTATION
    picture = cv2.imdecode(_contents(path), flags)
    if picture is None or picture.shape[:2] != (header.height, header.width):
        raise InputError(f"{path}: the picture is damaged and cannot be decoded; copy or make the file again")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB) if color else picture


def _contents(path: Path) -> UInt8[np.ndarray, " N"]:
    """A picture's bytes. A PNG's chunks must lie within it: OpenCV makes room for whatever length one claims."""
    data = path.read_bytes()
    place = len(_PNG_SIGNATURE)
    while data.startswith(_PNG_SIGNATURE) and place < len(data):
        claimed = int.from_bytes(data[place : place + 4], "big")
        if data[place + 4 : place + 8] == b"IEND":
            break
        place += 12 + claimed
        if place > len(data):
            raise InputError(f"{path}: the picture is damaged and cannot be decoded; copy or make the file again")
    return np.frombuffer(data, np.uint8)


def _eight_bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values if values.dtype == np.uint8 else (values // 257).astype(np.uint8))


def write_png(path: Path, picture: UInt8[np.ndarray, "H W 3"] | UInt8[np.ndarray, "H W"]) -> None:
    """Write 8-bit RGB or gray atomically, without loss."""
    import cv2

    pixels = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else np.ascontiguousarray(picture)
    _write(path, cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1, *_ONE_FILTER]))


def write_jpeg(path: Path, picture: UInt8[np.ndarray, "H W 3"], quality: int = 90) -> None:
    """Write 8-bit RGB as JPEG atomically; for previews only."""
    import cv2

    _write(path, cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality]))


def _write(path: Path, encoded: tuple[bool, np.ndarray]) -> None:
    done, data = encoded
    if not done:
        raise ValueError(f"{path}: the picture cannot be encoded")
    write_atomically(path, lambda stream: stream.write(data.tobytes()), durable=False)
