"""Images that a tracker stores in its own npz files, as a frame source (flame-head-tracker's `img`)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from ggavatar.io.npz import npz_headers, read_npz
from preprocess.video.frame import DecodedFrame

KEY = "img"


def stored_images(folder: Path) -> dict[int, Path]:
    """Npz files with an image, by the number that is their name, ascending; none if the folder has no such files."""
    files = {int(path.stem): path for path in folder.glob("*.npz") if path.stem.isdecimal() and len(path.stem) < 10}
    for path in sorted(files.values())[:3]:
        try:
            if KEY in npz_headers(path):
                return dict(sorted(files.items()))
        except InputError:
            continue
    return {}


class StoredImages:
    """The images of a folder of npz files.

    Raises:
        InputError: No npz file with an image.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self.path = path
        self._fps = fps
        self._errors: list[str] = []
        self._files = stored_images(path)
        if not self._files:
            raise InputError(f"{path}: expected npz files with an image under {KEY!r}, found none; give a video")

    def frames(self) -> Iterator[DecodedFrame]:
        """All images in order of their numbers; files without one are left out and listed by `decode_errors`."""
        self._errors = []
        size: tuple[int, int] | None = None
        for row, (number, path) in enumerate(self._files.items()):
            try:
                height, width = _size(path)
                if size not in (None, (height, width)):
                    raise InputError(f"{path}: expected images of one size, found {width}×{height} px")
            except InputError as error:
                self._errors.append(str(error))
                continue
            size = (height, width)
            yield DecodedFrame(number, row / self._fps, width, height, partial(_image, path))

    def decode_errors(self) -> list[str]:
        """What was wrong with the files that were left out."""
        return self._errors

    def conversions(self) -> list[str]:
        """Nothing: arrays of pixels carry neither orientation nor profile."""
        return []


def _size(path: Path) -> tuple[int, int]:
    """Height and width of the image in a file, from its header."""
    header = npz_headers(path).get(KEY)
    shape = () if header is None else header.shape
    if header is None or header.dtype != np.uint8 or shape[-1:] != (3,) or len(shape) not in (3, 4):
        raise InputError(f"{path}: expected an 8-bit RGB image under {KEY!r}, found {shape or 'none'}; track it again")
    if (len(shape) == 4 and shape[0] != 1) or not all(1 <= side <= 8192 for side in shape[-3:-1]):
        raise InputError(f"{path}: expected one image of at most 8192 px, found {shape}; track the video again")
    return shape[-3], shape[-2]


def _image(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    return read_npz(path, [KEY])[KEY].reshape(*_size(path), 3)
