"""Decodes images for scoring: 8-bit RGB, with a note of every conversion."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.data.background import Color
from ggavatar.errors import InputError
from ggavatar.io.images import image_header


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

    16-bit values are rounded to the nearest of 256 levels (the protocol's quantization), gray is repeated, palettes are
    expanded. Straight alpha is composited on the protocol's background in sRGB; if the protocol leaves the background
    open, an image that is not fully opaque is an error, since its background would be a guess.

    Args:
        path: PNG or JPEG file.
        background: sRGB in [0, 1], or None if the protocol leaves it open.

    Raises:
        InputError: The file is missing or damaged, or transparent without a known background.
    """
    header = image_header(path)
    content = path.read_bytes()
    values = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None or values.shape[:2] != (header.height, header.width):
        raise InputError(f"{path}: the image is damaged and cannot be decoded; render or copy it again")
    notes = []
    if values.dtype != np.uint8:
        notes.append("16-bit images rounded to 8 bits")
    if header.channels < 3:
        notes.append("grayscale images repeated to RGB")
    color, alpha = _split(_unit(values) if _needs_scaling(values) else values)
    if alpha is not None and float(alpha.min()) < 1:
        color = _composited(path, color, alpha, background)
        notes.append("transparent images composited on the background")
    pixels = color if color.dtype == np.uint8 else np.round(np.clip(color, 0, 1) * 255).astype(np.uint8)
    return DecodedImage(np.ascontiguousarray(pixels), hashlib.sha256(content).hexdigest(), tuple(notes))


def read_weights(path: Path) -> tuple[Float[np.ndarray, "H W"], str]:
    """A mask as weights in [0, 1] (its alpha channel, if any), and the SHA-256 of its file.

    Raises:
        InputError: The file is missing or damaged.
    """
    image_header(path)
    content = path.read_bytes()
    values = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise InputError(f"{path}: the mask is damaged and cannot be decoded; write it again")
    unit = _unit(values)
    if unit.ndim == 3:
        unit = unit[..., 3] if unit.shape[2] == 4 else unit.mean(axis=2)
    return np.ascontiguousarray(unit, dtype=np.float32), hashlib.sha256(content).hexdigest()


def _needs_scaling(values: np.ndarray) -> bool:
    return values.dtype != np.uint8 or (values.ndim == 3 and values.shape[2] == 4)


def _unit(values: np.ndarray) -> np.ndarray:
    """Integers of any width as float64 in [0, 1]."""
    return values / np.float64(np.iinfo(values.dtype).max)


def _split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """RGB and straight alpha (or None) of an image in OpenCV's channel order."""
    if values.ndim == 2:
        return np.repeat(values[..., None], 3, axis=2), None
    alpha = values[..., 3:] if values.shape[2] == 4 else None
    return values[..., 2::-1], alpha


def _composited(path: Path, color: np.ndarray, alpha: np.ndarray, background: Color | None) -> np.ndarray:
    if background is None:
        raise InputError(f"{path}: the image is transparent and its background unknown; pass --background")
    return color * alpha + np.asarray(background) * (1 - alpha)
