"""Reading and writing PNG and JPEG files, with sizes checked before anything is decoded.

The headers are parsed here rather than by Pillow: Pillow does not report the bit depth of 16-bit RGB files, which the
check against decompression bombs needs, takes 52 µs instead of 15 µs a file (captures hold thousands), and would be one
more dependency. OpenCV decodes.
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
"""Largest image that is decoded (34 megapixels); 8K video has 33.2."""

MAX_COMPRESSION_RATIO = 1100
"""Largest ratio of decoded size to file size that is plausible; deflate reaches 1032.

A file whose header claims more is damaged.
"""

_PNG_FILTER_UP = (19, 32)
"""IMWRITE_PNG_FILTER = UP: files 3 % larger than with the best filter per row, written and read a third faster.

OpenCV names these numbers only from 4.12 on; older versions ignore them and always use one filter.
"""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_JPEG_FRAMES = frozenset({0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})


class ImageHeader(NamedTuple):
    """Size and pixel format that an image file's header states."""

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
            header = _parse_header(stream)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: expected an image, found a folder") from error
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
    if decoded_bytes > MAX_COMPRESSION_RATIO * (path.stat().st_size + 100):
        raise InputError(
            f"{path}: the file is far too small for {header.width}×{header.height} px, so it is damaged; "
            "copy or create it again"
        )
    return header


def _parse_header(stream: IO[bytes]) -> ImageHeader | None:
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
    """An image as 8-bit sRGB: gray is repeated, 16 bits are reduced to 8, transparency is dropped."""
    return _decode(path, color=True)


def read_gray(path: Path) -> UInt8[np.ndarray, "H W"]:
    """A mask as 8-bit gray: the alpha channel where there is one, else the luminance."""
    import cv2

    header = image_header(path)
    if header.channels in (2, 4):
        image = cv2.imdecode(_checked_bytes(path), cv2.IMREAD_UNCHANGED)
        if image is not None and image.ndim == 3:
            return _to_uint8(image[..., -1])
    return _decode(path, color=False)


def read_unchanged(path: Path) -> np.ndarray:
    """The stored values: H×W, or H×W×3 or H×W×4 in the order red, green, blue, alpha; 8 or 16 bits; palettes as colors.

    Meant for files whose values are not colors, such as masks. Gray with alpha is returned as H×W×4.
    """
    import cv2

    header = image_header(path)
    image = cv2.imdecode(_checked_bytes(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[:2] != (header.height, header.width):
        raise _damaged(path)
    if image.ndim == 2:
        return image
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def _decode(path: Path, color: bool) -> np.ndarray:
    import cv2

    header = image_header(path)
    flags = (cv2.IMREAD_COLOR if color else cv2.IMREAD_GRAYSCALE) | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(_checked_bytes(path), flags)
    if image is None or image.shape[:2] != (header.height, header.width):
        raise _damaged(path)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if color else image


def _damaged(path: Path) -> InputError:
    return InputError(f"{path}: the image is damaged and cannot be decoded; copy or create the file again")


def _checked_bytes(path: Path) -> UInt8[np.ndarray, " N"]:
    """The file's bytes; PNG chunks must lie within the file, since OpenCV allocates whatever length one claims."""
    data = path.read_bytes()
    position = len(_PNG_SIGNATURE)
    while data.startswith(_PNG_SIGNATURE) and position < len(data):
        claimed_length = int.from_bytes(data[position : position + 4], "big")
        if data[position + 4 : position + 8] == b"IEND":
            break
        position += 12 + claimed_length
        if position > len(data):
            raise _damaged(path)
    return np.frombuffer(data, np.uint8)


def _to_uint8(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values if values.dtype == np.uint8 else (values // 257).astype(np.uint8))


def write_png(path: Path, image: UInt8[np.ndarray, "H W 3"] | UInt8[np.ndarray, "H W"]) -> None:
    """Write 8-bit RGB or gray atomically and losslessly."""
    import cv2

    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else np.ascontiguousarray(image)
    _write(path, cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1, *_PNG_FILTER_UP]))


def write_jpeg(path: Path, image: UInt8[np.ndarray, "H W 3"], quality: int = 90) -> None:
    """Write 8-bit RGB as JPEG atomically; for previews only."""
    import cv2

    _write(path, cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality]))


def _write(path: Path, encoded: tuple[bool, np.ndarray]) -> None:
    succeeded, data = encoded
    if not succeeded:
        raise ValueError(f"{path}: OpenCV cannot encode the image")
    write_atomically(path, lambda stream: stream.write(data.tobytes()), durable=False)
