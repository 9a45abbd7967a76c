"""Decoding a video or reading a folder of pictures, one frame at a time.

With the numbers and times the source gives them.
"""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from preprocess.video.frame import FrameSource
from preprocess.video.image_folder import ImageFolder


def open_source(path: Path, fps: float | None = None) -> FrameSource:
    """A video file or a folder of pictures as a source.

    Args:
        path: The file or folder.
        fps: Rate of a folder of pictures; 25 if None.

    Raises:
        InputError: No such file, or nothing that can be decoded.
    """
    from preprocess.video.decoding import Video

    if path.is_dir():
        return ImageFolder(path, fps or 25.0)
    if not path.exists():
        raise InputError(f"{path}: no such file; give a video or a folder of PNG or JPEG pictures")
    return Video(path)
