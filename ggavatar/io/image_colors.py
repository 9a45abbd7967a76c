"""What a PNG or JPEG file states about its colors: ICC profile, code points, gamma, chromaticities, CMYK."""

from __future__ import annotations

import struct
import zlib
from typing import NamedTuple

from ggavatar.io.image_header import PNG_SIGNATURE
from ggavatar.io.picture_bytes import png_chunks
from ggavatar.pictures.color import (
    ColorConversion,
    ColorSpace,
    UnsupportedColorError,
    conversion_to_srgb,
    tagged_color_space,
)
from ggavatar.pictures.gamut import BT709, is_srgb
from ggavatar.pictures.profiles import ProfileConversion, profile_conversion

MAX_PROFILE_BYTES = 1 << 23
"""Largest ICC profile that is unpacked; printers' profiles have about 3 MB."""

_STATEMENTS = (b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM", b"tRNS")
_MAX_SEGMENTS = 10_000
_ICC_SIGNATURE = b"ICC_PROFILE\0"
_DISPLAY_GAMMAS = (1.85, 2.45)
"""Exponents that are taken as sRGB: ffmpeg writes 1.96 for the camera curve of BT.709 into the images it extracts."""


class StatedColors(NamedTuple):
    """What a file states; None for what it does not.

    Attributes:
        profile: The ICC profile.
        code_points: PNG's cICP: primaries and transfer curve by ITU-T H.273, and whether the range is full.
        gamma: The exponent that makes PNG's values linear.
        chromaticities: The xy of red, green, blue and white in a PNG.
        is_srgb: Whether a PNG says that it is sRGB.
        has_transparency: Whether a PNG has a tRNS chunk.
        is_cmyk: Whether a JPEG has four channels.
    """

    profile: bytes | None = None
    code_points: tuple[int, int, bool] | None = None
    gamma: float | None = None
    chromaticities: tuple[float, ...] | None = None
    is_srgb: bool = False
    has_transparency: bool = False
    is_cmyk: bool = False


def stated_colors(data: bytes) -> StatedColors:
    """What a whole PNG or JPEG file states about its colors; damaged statements are left out."""
    return _png_colors(data) if data.startswith(PNG_SIGNATURE) else _jpeg_colors(data)


def color_conversion(stated: StatedColors) -> ColorConversion | ProfileConversion | None:
    """The conversion to sRGB that a file needs; None if it is sRGB, or states nothing.

    PNG's statements in the order of its specification: cICP, ICC profile, sRGB, then gamma with chromaticities.

    Raises:
        UnsupportedColorError: A color space that is stated and cannot be converted.
        ValueError: A damaged ICC profile.
    """
    if stated.code_points:
        primaries, transfer, full = stated.code_points
        if not full:
            raise UnsupportedColorError("RGB of narrow range")
        return conversion_to_srgb(tagged_color_space(primaries, transfer))
    if stated.profile is not None:
        return profile_conversion(stated.profile)
    if stated.is_srgb or (stated.gamma is None and stated.chromaticities is None):
        return None
    usual = stated.gamma is None or _DISPLAY_GAMMAS[0] <= stated.gamma <= _DISPLAY_GAMMAS[1]
    corners = stated.chromaticities or BT709
    return conversion_to_srgb(ColorSpace(2, BT709 if is_srgb(corners) else corners, None if usual else stated.gamma))


def _png_colors(data: bytes) -> StatedColors:
    stated = StatedColors()
    for kind, body in _png_statements(data).items():
        if kind == b"cICP" and len(body) == 4:
            stated = stated._replace(code_points=(body[0], body[1], body[3] == 1))
        elif kind == b"iCCP":
            stated = stated._replace(profile=_unpacked_profile(body))
        elif kind == b"sRGB":
            stated = stated._replace(is_srgb=True)
        elif kind == b"gAMA" and len(body) == 4 and any(body):
            stated = stated._replace(gamma=100_000 / struct.unpack(">I", body)[0])
        elif kind == b"cHRM" and len(body) == 32:
            white_first = [value / 100_000 for value in struct.unpack(">8I", body)]
            stated = stated._replace(chromaticities=(*white_first[2:], *white_first[:2]))
        elif kind == b"tRNS":
            stated = stated._replace(has_transparency=True)
    return stated


def _png_statements(data: bytes) -> dict[bytes, bytes]:
    """The first chunk of every kind before the pixels; the specification allows one of each that states colors."""
    found: dict[bytes, bytes] = {}
    for kind, start, end in png_chunks(data):
        if kind == b"IDAT":
            break
        if kind in _STATEMENTS:
            found.setdefault(kind, data[start:end])
    return found


def _unpacked_profile(body: bytes) -> bytes | None:
    """The profile in an iCCP chunk: name, 0, method, deflated profile."""
    try:
        unpacker = zlib.decompressobj()
        profile = unpacker.decompress(body[body.index(b"\0") + 2 :], MAX_PROFILE_BYTES)
        return None if unpacker.unconsumed_tail else profile
    except (ValueError, zlib.error):
        return None


def _jpeg_colors(data: bytes) -> StatedColors:
    """The ICC profile in the APP2 segments of a JPEG file (ICC.1, annex B.4), and the number of its channels."""
    parts: dict[int, bytes] = {}
    place, channels = 2, 3
    for _ in range(_MAX_SEGMENTS):
        if place + 4 > len(data) or data[place] != 0xFF:
            break
        marker = data[place + 1]
        if marker == 0xFF:
            place += 1
            continue
        length = int.from_bytes(data[place + 2 : place + 4], "big")
        body = data[place + 4 : place + 2 + length]
        if marker == 0xE2 and body.startswith(_ICC_SIGNATURE) and len(body) > len(_ICC_SIGNATURE) + 2:
            parts[body[len(_ICC_SIGNATURE)]] = body[len(_ICC_SIGNATURE) + 2 :]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            channels = body[5] if len(body) > 5 else 3
        if marker == 0xDA or length < 2:
            break
        place += 2 + length
    profile = b"".join(parts[key] for key in sorted(parts)) if parts else None
    return StatedColors(profile=profile, is_cmyk=channels == 4)
