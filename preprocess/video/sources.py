"""Opening a video or an image folder as a frame source."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from preprocess.video.frame import FrameSource
from preprocess.video.image_folder import ImageFolder
from preprocess.video.stored_images import StoredImages, stored_images


def open_source(path: Path, fps: float | None = None) -> FrameSource:
    """A video file or an image folder as a frame source.

    Args:
        path: The file or folder; a folder of flame-head-tracker's npz files is one of images too.
        fps: Frame rate of an image folder; 25 if None.

    Raises:
        InputError: No such file, or nothing that can be decoded.
    """
    from preprocess.video.decoding import Video

    if path.is_dir():
        return StoredImages(path, fps or 25.0) if stored_images(path) else ImageFolder(path, fps or 25.0)
    if not path.exists():
        raise InputError(f"{path}: no such file; give a video or a folder of PNG or JPEG images")
    return Video(path)
