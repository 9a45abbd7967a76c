"""Decodes images for scoring: upright 8-bit sRGB, with a note of every conversion."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.data.background import Color
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.io.picture_decoding import read_picture, read_unchanged, to_8_bits


class DecodedImage(NamedTuple):
    """A decoded image and how it was converted.

    Attributes:
        pixels: 8-bit RGB.
        sha256: SHA-256 of the file, hex.
        notes: Conversions to 8-bit RGB, in words; empty for most files.
    """

    pixels: UInt8[np.ndarray, "H W 3"]
    sha256: str
    notes: tuple[str, ...]


def read_scored(path: Path, background: Color | None) -> DecodedImage:
    """Decode a prediction or a ground-truth image.

    EXIF turns the image upright and colors become sRGB as in `ggavatar.io.picture_decoding`. 16-bit values are rounded
    to the nearest of 256 levels (the protocol's quantization), gray is repeated, palettes are expanded. Straight alpha
    is composited on the protocol's background in sRGB; if the protocol leaves the background open, an image that is not
    fully opaque is an error, since its background would be a guess.

    Args:
        path: PNG or JPEG file.
        background: sRGB in [0, 1], or None if the protocol leaves it open.

    Raises:
        InputError: The file is missing or damaged, or transparent without a known background.
    """
    picture = read_picture(path)
    color, alpha, notes = picture.color, picture.alpha, list(picture.notes)
    if alpha is not None and int(alpha.min()) < np.iinfo(alpha.dtype).max:
        if background is None:
            raise InputError(f"{path}: the image is transparent and its background unknown; pass --background")
        coverage = _unit(alpha)[..., None]
        unit = _unit(color) * coverage + np.asarray(background) * (1 - coverage)
        color = np.round(np.clip(unit, 0, 1) * 255).astype(np.uint8)
        notes.append("transparent images composited on the background")
    return DecodedImage(np.ascontiguousarray(to_8_bits(color)), sha256_of(path), tuple(notes))


def read_weights(path: Path) -> tuple[Float[np.ndarray, "H W"], str]:
    """A mask as upright weights in [0, 1] (its alpha channel, if any), and the SHA-256 of its file.

    Raises:
        InputError: The file is missing or damaged.
    """
    unit = _unit(read_unchanged(path))
    if unit.ndim == 3:
        unit = unit[..., 3] if unit.shape[2] == 4 else unit.mean(axis=2)
    return np.ascontiguousarray(unit, dtype=np.float32), sha256_of(path)


def _unit(values: np.ndarray) -> np.ndarray:
    """Integers of any width as float64 in [0, 1]."""
    return values / np.float64(np.iinfo(values.dtype).max)
