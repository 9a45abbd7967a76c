"""The bytes of PNG and JPEG files, checked and reduced to what a decoder needs before one sees them.

The library libpng unpacks every text and profile in a file, though nobody asks for them (300 texts of 8 MB: 27 s), and
allocates the length that a chunk claims; libjpeg goes over the whole picture once for every scan (0.2 s each at the
largest size), of which a kilobyte can hold dozens.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.image_header import PNG_SIGNATURE
from ggavatar.io.regular_files import read_file

MAX_IMAGE_BYTES = 288 << 20
"""Largest file that is read: the largest image of four channels and 16 bits, not packed at all."""

MAX_CHUNKS = 100_000
"""Most chunks of a PNG: one each 8 KiB, as libpng writes them, is 35,000 in the largest file."""

MAX_SCANS = 24
"""Most scans of a JPEG; libjpeg's progressive files have ten."""

_MAX_MARKERS = 10_000
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")
_START_OF_SCAN, _END = 0xDA, 0xD9


def picture_bytes(path: Path) -> bytes:
    """The content of a PNG or JPEG file that is safe to decode.

    Raises:
        InputError: No such file, not a regular one, too large, or damaged.
    """
    data = read_file(path, MAX_IMAGE_BYTES, "an image")
    try:
        if data.startswith(PNG_SIGNATURE):
            list(png_chunks(data))
        else:
            _check_scans(data)
    except ValueError as error:
        raise InputError(f"{path}: the image is damaged ({error}); copy or create the file again") from error
    return data


def png_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of the content of all chunks of a PNG up to IEND.

    Raises:
        ValueError: One reaches beyond the file, or there are more than `MAX_CHUNKS`.
    """
    place = len(PNG_SIGNATURE)
    for _ in range(MAX_CHUNKS):
        if place >= len(data):
            return
        length, kind = int.from_bytes(data[place : place + 4], "big"), data[place + 4 : place + 8]
        end = place + 8 + length
        if end > len(data):
            raise ValueError("a part of it is cut off")
        yield kind, place + 8, end
        if kind == b"IEND":
            return
        place = end + 4
    raise ValueError(f"more than {MAX_CHUNKS} chunks")


def pixels_only(data: bytes) -> bytes:
    """A PNG without its texts, profiles, times and animations; anything else unchanged."""
    if not data.startswith(PNG_SIGNATURE):
        return data
    view, extra = memoryview(data), False
    kept = [view[:8]]
    for kind, start, end in png_chunks(data):
        if kind[:1].isupper() or kind == b"tRNS":
            kept.append(view[start - 8 : end + 4])
        else:
            extra = True
    return b"".join(kept) if extra else data


def _check_scans(data: bytes) -> None:
    """Count the scans of a JPEG up to its end marker; what is in other segments, such as thumbnails, does not count."""
    place, scans = 2, 0
    for _ in range(_MAX_MARKERS):
        found = _MARKER.search(data, place)
        if found is None or data[found.start() + 1] == _END:
            return
        scans += data[found.start() + 1] == _START_OF_SCAN
        if scans > MAX_SCANS:
            raise ValueError(f"more than {MAX_SCANS} scans")
        place = found.end() + int.from_bytes(data[found.end() : found.end() + 2], "big")
    raise ValueError(f"more than {_MAX_MARKERS} parts")
