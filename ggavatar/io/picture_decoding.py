"""Decoding of PNG and JPEG files of any kind: upright, sRGB, with a note of every conversion."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8, UInt16

from ggavatar.errors import InputError
from ggavatar.io.image_colors import StatedColors, color_conversion, stated_colors
from ggavatar.io.image_header import ImageHeader, image_header
from ggavatar.io.picture_bytes import picture_bytes, pixels_only
from ggavatar.pictures.color import ColorConversion, UnsupportedColorError
from ggavatar.pictures.orientation import UPRIGHT
from ggavatar.pictures.profiles import ProfileConversion

Levels = UInt8[np.ndarray, "H W"] | UInt16[np.ndarray, "H W"]


class Picture(NamedTuple):
    """A decoded picture.

    Attributes:
        color: Upright sRGB, 8 bits, or 16 bits where the file has them and needs no conversion.
        alpha: Straight transparency, 8 or 16 bits; None where the file has none.
        notes: What was done to the stored pixels, in words; empty for most files.
    """

    color: UInt8[np.ndarray, "H W 3"] | UInt16[np.ndarray, "H W 3"]
    alpha: Levels | None
    notes: tuple[str, ...]


class PictureKind(NamedTuple):
    """What is known about a picture before its pixels are decoded.

    Attributes:
        header: Size and pixel format.
        stated: What the file states about its colors.
        conversion: The conversion to sRGB, if it needs one.
        notes: What will be done to the stored pixels, in words.
    """

    header: ImageHeader
    stated: StatedColors
    conversion: ColorConversion | ProfileConversion | None
    notes: tuple[str, ...]

    @property
    def has_alpha(self) -> bool:
        """Whether the file has transparency."""
        return not self.stated.is_cmyk and (self.header.channels in (2, 4) or self.stated.has_transparency)


def read_picture(path: Path) -> Picture:
    """Decode a picture: gray is repeated, palettes are expanded, colors become sRGB, EXIF turns it upright.

    Raises:
        InputError: No such file, damaged, or colors that cannot be converted.
    """
    header = image_header(path)
    data = picture_bytes(path)
    kind = _kind(path, header, data)
    stored = _cmyk(path, data) if kind.stated.is_cmyk else _unchanged(path, header, data)
    color, alpha = stored, None
    if kind.has_alpha and stored.ndim == 3 and stored.shape[2] == 4:
        color, alpha = stored[..., :3], np.ascontiguousarray(stored[..., 3])
    color = _converted(color, kind.conversion)
    if kind.stated.is_cmyk:
        color = kind.header.orientation.apply(color)
    return Picture(np.ascontiguousarray(color), alpha, kind.notes)


def read_unchanged(path: Path) -> np.ndarray:
    """The stored values, upright: [H, W], or [H, W, 3 or 4] in the order RGBA; 8 or 16 bits; palettes as colors.

    Gray with alpha is returned with four channels. For masks, whose values are not colors, and for `read_picture`.

    Raises:
        InputError: No such file, or damaged.
    """
    return _unchanged(path, image_header(path), picture_bytes(path))


def _unchanged(path: Path, header: ImageHeader, data: bytes) -> np.ndarray:
    import cv2

    values = cv2.imdecode(np.frombuffer(pixels_only(data), np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None or header.orientation.size(values.shape[1], values.shape[0]) != (header.width, header.height):
        raise _damaged(path)
    if values.ndim == 3:
        values = cv2.cvtColor(values, cv2.COLOR_BGR2RGB if values.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)
    return header.orientation.apply(values)


def picture_kind(path: Path) -> PictureKind:
    """What is known about a picture before its pixels are decoded.

    Raises:
        InputError: No such file, damaged, or colors that cannot be converted.
    """
    return _kind(path, image_header(path), picture_bytes(path))


def _kind(path: Path, header: ImageHeader, data: bytes) -> PictureKind:
    stated = stated_colors(data)
    notes, conversion = [], None
    if header.orientation != UPRIGHT:
        notes.append(f"images {header.orientation.words}, as their EXIF orientation says")
    if stated.is_cmyk:
        notes.append("images in CMYK converted to sRGB")
    try:
        conversion = color_conversion(stated)
    except UnsupportedColorError as error:
        raise InputError(
            f"{path}: the image states {error}, which cannot be converted to sRGB; save it as sRGB with an image editor"
        ) from error
    except ValueError as error:
        notes.append(f"embedded color profiles that cannot be used are ignored ({error})")
    if isinstance(conversion, ProfileConversion):
        gray = header.channels < 3
        if (conversion.mode == "L") != gray or (conversion.mode == "CMYK") != stated.is_cmyk:
            notes.append(f"color profiles {conversion.name!r} ignored: they are not for this kind of image")
            conversion = None
        else:
            notes.append(f"colors converted from the embedded profile {conversion.name!r} to sRGB")
    elif conversion is not None:
        notes.append(conversion.words)
    if header.bit_depth == 16:
        notes.append("16-bit images rounded to 8 bits")
    if header.channels < 3:
        notes.append("grayscale images repeated to RGB")
    return PictureKind(header, stated, conversion, tuple(notes))


def _cmyk(path: Path, data: bytes) -> UInt8[np.ndarray, "H W 4"]:
    """Stored CMYK; Pillow undoes Adobe's inversion."""
    from PIL import Image

    try:
        return np.array(Image.open(io.BytesIO(data), formats=["JPEG"]))
    except (OSError, ValueError, SyntaxError) as error:
        raise _damaged(path) from error


def _converted(stored: np.ndarray, conversion: ColorConversion | ProfileConversion | None) -> np.ndarray:
    """Stored gray, RGB or CMYK as sRGB, still as it lies in the file."""
    if isinstance(conversion, ProfileConversion):
        if stored.ndim == 3 and conversion.mode == "L":
            stored = stored[..., 0]
        return conversion.apply(to_8_bits(stored))
    if stored.ndim == 3 and stored.shape[2] == 4:
        light = 255 - stored.astype(np.float32)
        stored = np.rint(light[..., :3] * light[..., 3:] / 255).astype(np.uint8)
    color = np.repeat(stored[..., None], 3, axis=2) if stored.ndim == 2 else stored
    return color if conversion is None else conversion.apply(color)


def to_8_bits(values: np.ndarray) -> UInt8[np.ndarray, "*S"]:
    """Integers of 8 or 16 bits rounded to the nearest of 256 levels."""
    return values if values.dtype == np.uint8 else ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)


def _damaged(path: Path) -> InputError:
    """The error for a file whose pixels cannot be decoded."""
    return InputError(f"{path}: the image is damaged and cannot be decoded; copy or create the file again")
