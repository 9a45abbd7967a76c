"""A folder of numbered images as a frame source."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.images import read_gray, read_rgb
from ggavatar.io.picture_decoding import picture_kind
from preprocess.video.frame import DecodedFrame

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})


class ImageFolder:
    """PNG or JPEG files with the frame number in their names.

    Raises:
        InputError: No images in the folder.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self.path = path
        self._fps = fps
        self._conversions: dict[str, None] = {}
        self._files = numbered_images(path)
        if not self._files:
            raise InputError(
                f"{path}: no images in this folder; expected PNG or JPEG files with frame numbers in their names"
            )

    def frames(self) -> Iterator[DecodedFrame]:
        """All images in order of their numbers.

        Raises:
            InputError: The images differ in size.
        """
        size: tuple[int, int] | None = None
        self._conversions = {}
        for row, (number, path) in enumerate(self._files.items()):
            kind = picture_kind(path)
            header = kind.header
            self._conversions |= dict.fromkeys(kind.notes)
            size = size or (header.width, header.height)
            if (header.width, header.height) != size:
                found = f"{header.width}×{header.height}"
                raise InputError(f"{path}: expected {size[0]}×{size[1]} px like the first image, found {found}")
            alpha = partial(read_gray, path) if kind.has_alpha else None
            yield DecodedFrame(number, row / self._fps, header.width, header.height, partial(read_rgb, path), alpha)

    def decode_errors(self) -> list[str]:
        """Empty: an image that cannot be read raises an error instead."""
        return []

    def conversions(self) -> list[str]:
        """What is done to bring the images to upright 8-bit sRGB; complete once `frames` is exhausted."""
        return list(self._conversions)


def numbered_images(folder: Path) -> dict[int, Path]:
    """PNG and JPEG files of a folder by the last number in their names, ascending.

    If a number is missing or repeated, files are numbered by position in sorted order instead.
    """
    files = sorted(
        path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    )
    digits = [re.findall(r"\d+", path.stem) for path in files]
    numbers = [int(found[-1]) if found and len(found[-1]) <= 9 else -1 for found in digits]
    if len(set(numbers)) == len(files) and min(numbers, default=0) >= 0:
        return dict(sorted(zip(numbers, files, strict=True)))
    return dict(enumerate(files))
