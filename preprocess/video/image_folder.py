"""A folder of numbered images as a frame source."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.frame_names import frame_numbers
from ggavatar.io.image_suffixes import IMAGE_SUFFIXES
from ggavatar.io.images import read_gray, read_rgb
from ggavatar.io.picture_decoding import picture_kind
from preprocess.video.frame import DecodedFrame


class ImageFolder:
    """PNG or JPEG files with the frame number in their names, or listed with it.

    Args:
        path: The folder.
        fps: Frame rate.
        camera: Camera of names that tell several apart; the first if None.
        listed: The images by frame number where a list in the folder names them.

    Raises:
        InputError: No images in the folder, or it cannot be told which number counts the frames.
    """

    def __init__(
        self, path: Path, fps: float, camera: int | None = None, listed: Mapping[int, Path] | None = None
    ) -> None:
        self.path = path
        self._fps = fps
        self._conversions: dict[str, None] = {}
        numbered = NumberedImages(listed) if listed else numbered_images(path, camera)
        self._files, self.notes = numbered.files, numbered.notes
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


@dataclass(frozen=True)
class NumberedImages:
    """The images of a folder by frame number.

    Attributes:
        files: By frame number, ascending.
        notes: What was assumed about their names, in words.
        by_position: Whether they are numbered by position, since no name has a number in it.
    """

    files: Mapping[int, Path]
    notes: tuple[str, ...] = ()
    by_position: bool = False


def numbered_images(folder: Path, camera: int | None = None) -> NumberedImages:
    """PNG and JPEG files of a folder by the frame number in their names (see `ggavatar.io.frame_names`).

    Files are numbered by position in sorted order only if no name has a number in it.

    Raises:
        InputError: It cannot be told which number counts the frames, or there is no such camera.
    """
    files = sorted(
        path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    )
    found = frame_numbers([path.stem for path in files], folder, camera)
    if files and all(number is None for number in found.numbers):
        note = f"{folder}: no numbers in the names of the images, which are numbered in alphabetical order"
        return NumberedImages(dict(enumerate(files)), (note,), by_position=True)
    return NumberedImages(found.by_number(files), tuple(f"{folder}: {note}" for note in found.notes))
