"""Folders of 8-bit images named by source frame number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.frame_names import frame_numbers
from ggavatar.io.image_suffixes import IMAGE_SUFFIXES


def frame_file(folder: Path, frame: int) -> Path:
    """Path of a frame's image in a folder written by us."""
    return folder / f"{frame:06d}.png"


def frame_files(folder: Path) -> dict[int, Path]:
    """Images of a folder by ascending frame number, read from their names as `ggavatar.io.frame_names` does.

    Raises:
        InputError: The folder is missing or contains no image, it cannot be told which number counts the frames, two
            files have the same one, or there are images of several cameras.
    """
    if not folder.is_dir():
        instead = "a file" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: expected a folder of images, found {instead}; check the path")
    files = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    ]
    names = frame_numbers([path.stem for path in files], folder)
    if names.cameras:
        cameras = ", ".join(map(str, names.cameras))
        raise InputError(
            f"{folder}: expected one image per frame, found those of cameras {cameras}; evaluate one camera at a time, "
            "from a folder of its own"
        )
    found = {number: path for number, path in zip(names.numbers, files, strict=True) if number is not None}
    if not found:
        raise InputError(f"{folder}: expected images named by frame number such as 000123.png, found none")
    return dict(sorted(found.items()))


def find_frame(folder: Path, frame: int) -> Path:
    """The image of one frame, however it is named; `InputError` if the folder has none."""
    path = frame_file(folder, frame)
    if path.is_file():
        return path
    files = frame_files(folder)
    if frame not in files:
        raise InputError(
            f"{folder}: expected an image of frame {frame}, found none; render it, or choose another frame"
        )
    return files[frame]


def common_frames(folders: Sequence[Path]) -> list[int]:
    """Ascending frame numbers present in every folder; `InputError` if there are none."""
    numbers = set.intersection(*(set(frame_files(folder)) for folder in folders))
    if not numbers:
        raise InputError(
            f"expected frames common to {', '.join(map(str, folders))}, found none; render the same split for all"
        )
    return sorted(numbers)
