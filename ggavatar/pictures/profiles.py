"""Embedded ICC profiles: conversion of 8-bit pixels to sRGB by LittleCMS, through Pillow."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

_GRID = 9
"""Levels of each channel at which a profile is compared with sRGB."""


class ProfileConversion(NamedTuple):
    """A conversion to sRGB.

    Attributes:
        name: The profile's own description.
        mode: Pillow's name of the pixels that the profile describes: RGB, L (gray) or CMYK.
        transform: Pillow's transform.
    """

    name: str
    mode: str
    transform: Any

    def apply(self, pixels: UInt8[np.ndarray, "H W C"] | UInt8[np.ndarray, "H W"]) -> UInt8[np.ndarray, "H W 3"]:
        """Pixels in the profile's space as sRGB."""
        from PIL import Image, ImageCms

        return np.array(ImageCms.applyTransform(Image.fromarray(np.ascontiguousarray(pixels)), self.transform))


@lru_cache(maxsize=16)
def profile_conversion(profile: bytes) -> ProfileConversion | None:
    """The conversion that an ICC profile asks for; None if it is sRGB to within one level.

    Colors are converted relative to white (relative colorimetric intent).

    Raises:
        ValueError: The profile is damaged, or describes no RGB, gray or CMYK.
    """
    from PIL import ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}[opened.profile.xcolor_space.strip()]
        name = " ".join((opened.profile.profile_description or "unnamed").split())
        intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
        transform = ImageCms.buildTransform(opened, ImageCms.createProfile("sRGB"), mode, "RGB", intent)
    except (ImageCms.PyCMSError, OSError, KeyError, ValueError, TypeError) as error:
        raise ValueError(f"unusable ICC profile: {error}") from error
    found = ProfileConversion(name[:60], mode, transform)
    if mode == "CMYK":
        return found
    levels = np.linspace(0, 255, _GRID).round().astype(np.uint8)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(_GRID, -1, 3)
    given = grid if mode == "RGB" else grid[..., 0]
    same = grid if mode == "RGB" else np.repeat(given[..., None], 3, axis=2)
    return None if np.abs(found.apply(given).astype(int) - same).max() <= 1 else found
