"""Headers of PNG and JPEG files, with sizes checked before anything is decoded.

The headers are parsed here rather than by Pillow: Pillow does not report the bit depth of 16-bit RGB files, which the
check against decompression bombs needs, and takes longer (52 µs a file; captures hold thousands).
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import IO, NamedTuple

from ggavatar.errors import InputError
from ggavatar.io.regular_files import open_regular
from ggavatar.pictures.orientation import UPRIGHT, Orientation, exif_orientation

MAX_PIXELS = 34_000_000
"""Largest image that is decoded (34 megapixels); 8K video has 33.2."""

MAX_COMPRESSION_RATIO = 1100
"""Largest ratio of decoded size to file size that is plausible; deflate reaches 1032.

A file whose header claims more is damaged.
"""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
EXIF_SIGNATURE = b"Exif\0\0"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_JPEG_FRAMES = frozenset({0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})
_TAIL = 1 << 16
"""Bytes at the end of a PNG that are searched for EXIF, which some programs write after the pixels."""


class ImageHeader(NamedTuple):
    """Size and pixel format that an image file's header states.

    Attributes:
        width: Width of the upright image, px.
        height: Height of the upright image, px.
        channels: Channels as stored; a palette counts as three.
        bit_depth: Bits of a channel.
        orientation: What makes the stored pixels upright, by EXIF.
    """

    width: int
    height: int
    channels: int
    bit_depth: int
    orientation: Orientation = UPRIGHT


def image_header(path: Path) -> ImageHeader:
    """Upright size, channels, bit depth and orientation of a PNG or JPEG file, from its header alone.

    Raises:
        InputError: No such file, neither PNG nor JPEG, damaged, empty or larger than `MAX_PIXELS`.
    """
    try:
        with open_regular(path, "an image") as stream:
            header, size = _parse_header(stream), os.fstat(stream.fileno()).st_size
    except struct.error as error:
        raise InputError(f"{path}: the image header is truncated; copy or create the file again") from error
    if header is None:
        raise InputError(f"{path}: expected a PNG or JPEG image, found another file type")
    if header.width < 1 or header.height < 1 or header.width * header.height > MAX_PIXELS:
        raise InputError(
            f"{path}: expected an image of 1 px to {MAX_PIXELS // 1_000_000} megapixels, "
            f"found {header.width}×{header.height} px; resize it"
        )
    decoded_bytes = header.width * header.height * header.channels * header.bit_depth // 8
    if decoded_bytes > MAX_COMPRESSION_RATIO * (size + 100):
        raise InputError(
            f"{path}: the file is far too small for {header.width}×{header.height} px, so it is damaged; "
            "copy or create it again"
        )
    return header


def _parse_header(stream: IO[bytes]) -> ImageHeader | None:
    start = stream.read(8)
    if start == PNG_SIGNATURE:
        length, kind, width, height, depth, color = struct.unpack(">I4sIIBB", stream.read(18))
        if kind != b"IHDR" or length != 13 or color not in _PNG_CHANNELS:
            return None
        stream.seek(7, os.SEEK_CUR)
        orientation = _png_orientation(stream)
        return ImageHeader(*orientation.size(width, height), _PNG_CHANNELS[color], depth, orientation)
    if start[:2] == b"\xff\xd8":
        stream.seek(2)
        return _parse_jpeg(stream)
    return None


def _png_orientation(stream: IO[bytes]) -> Orientation:
    """The orientation in an eXIf chunk before the pixels or, less usual, close to the end of the file."""
    for _ in range(1000):
        start = stream.read(8)
        if len(start) < 8 or start[4:] == b"IDAT":
            break
        length = int.from_bytes(start[:4], "big")
        if start[4:] == b"eXIf":
            return exif_orientation(stream.read(min(length, 1 << 16)))
        stream.seek(length + 4, os.SEEK_CUR)
    stream.seek(max(0, os.fstat(stream.fileno()).st_size - _TAIL))
    tail = stream.read(_TAIL)
    place = tail.find(b"eXIf")
    return UPRIGHT if place < 0 else exif_orientation(tail[place + 4 :])


def _parse_jpeg(stream: IO[bytes]) -> ImageHeader | None:
    """Walk the segments of a JPEG file to its frame header; the EXIF block lies before it."""
    orientation = UPRIGHT
    for _ in range(1000):
        (marker,) = struct.unpack(">H", stream.read(2))
        if marker == 0xFFFF:
            stream.seek(-1, os.SEEK_CUR)
            continue
        if marker >> 8 != 0xFF:
            return None
        (length,) = struct.unpack(">H", stream.read(2))
        if marker & 0xFF in _JPEG_FRAMES:
            depth, height, width, channels = struct.unpack(">BHHB", stream.read(6))
            return ImageHeader(*orientation.size(width, height), channels, depth, orientation)
        if marker == 0xFFE1 and length >= 8:
            segment = stream.read(length - 2)
            if segment.startswith(EXIF_SIGNATURE):
                orientation = exif_orientation(segment[len(EXIF_SIGNATURE) :])
            continue
        stream.seek(length - 2, os.SEEK_CUR)
    return None
