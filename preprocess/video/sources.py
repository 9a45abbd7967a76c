"""Opening a video or an image folder as a frame source."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from preprocess.video.frame import FrameSource
from preprocess.video.image_folder import ImageFolder, numbered_images
from preprocess.video.listed_images import listed_images
from preprocess.video.stored_images import StoredImages, stored_images


def open_source(path: Path, fps: float | None = None, camera: int | None = None) -> FrameSource:
    """A video file or an image folder as a frame source.

    Args:
        path: The file or folder; also a folder of flame-head-tracker's npz files, or one with VHAP's transforms.json.
        fps: Frame rate of an image folder; 25 if None.
        camera: Camera of an image folder whose names tell several apart; the first if None.

    Raises:
        InputError: No such file, or nothing that can be decoded.
    """
    from preprocess.video.decoding import Video

    if path.is_dir():
        return _folder(path, fps or 25.0, camera)
    if not path.exists():
        raise InputError(f"{path}: no such file; give a video or a folder of PNG or JPEG images")
    return Video(path)


def _folder(path: Path, fps: float, camera: int | None) -> FrameSource:
    """The images in a folder, or those that a tracker stored or listed there."""
    if not numbered_images(path, camera).files:
        if stored_images(path):
            return StoredImages(path, fps)
        return ImageFolder(path, fps, camera, listed_images(path))
    return ImageFolder(path, fps, camera)
