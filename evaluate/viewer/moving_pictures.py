"""Moving pictures of a performer: a camera of this computer, or a video file in its place, played at its own speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from ggavatar.io.regular_files import open_regular

CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,ogg,gif,ivf,h264,hevc,m4v,nut"
"""Containers only: a playlist could make the decoder open other files or addresses."""
DEFAULT_FPS = 25.0
MOST_SIDE = 1280
"""Longer side to which larger pictures are reduced, px; a face does not need more."""

Picture = UInt8[np.ndarray, "_ _ 3"]


def pictures_of(source: str) -> Callable[[], Iterator[Picture]]:
    """What plays a camera (a number) or a video file, once, each time that it is called.

    Raises:
        InputError: There is no such camera or file, or it is no video.
    """
    if source.isdecimal() and not Path(source).exists():
        number = int(source)
        camera = cv2.VideoCapture(number)
        if not camera.isOpened():
            raise InputError(
                f"--webcam {source}: expected a camera of this number, found none that can be opened; try another "
                "number, or a video file in its place"
            )
        return lambda: camera_pictures(camera)
    path = Path(source)
    next(iter(_decoded(path)), None)  # fails now rather than in the thread
    return lambda: paced(_decoded(path))


def camera_pictures(camera: Any) -> Iterator[Picture]:
    """The newest picture of a camera, whenever one is wanted; ends when it gives none."""
    camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    while True:
        is_read, image = camera.read()
        if not is_read:
            return
        yield reduced(np.ascontiguousarray(image[..., ::-1]))


def paced(
    timed: Iterator[tuple[float, Picture]],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Picture]:
    """Pictures when their time has come; those whose successor's has come too are left out.

    Args:
        timed: Moment, s, and picture, in order.
        clock: Tells the time, s.
        sleep: Waits, s.
    """
    began: float | None = None
    waiting: tuple[float, Picture] | None = None
    for moment, image in timed:
        began = clock() - moment if began is None else began
        now = clock() - began
        if waiting is not None and moment > now:
            if waiting[0] > now:
                sleep(waiting[0] - now)
            yield waiting[1]
        waiting = moment, image
    if waiting is not None:
        yield waiting[1]


def _decoded(path: Path) -> Iterator[tuple[float, Picture]]:
    """Moment and pixels of every frame of a file, which is opened here: the decoder sees nothing else."""
    with open_regular(path, "a video") as file:
        try:
            with av.open(file, options={"format_whitelist": CONTAINERS}) as container:
                if not container.streams.video:
                    raise InputError(f"{path}: expected a video, found no pictures in it")
                stream = container.streams.video[0]
                rate = float(stream.average_rate or DEFAULT_FPS)
                for index, frame in enumerate(container.decode(stream)):
                    yield index / rate, reduced(frame.to_ndarray(format="rgb24"))
        except (av.error.FFmpegError, ValueError, OSError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: expected a video that can be decoded, found another file ({error})") from error


def reduced(image: Picture) -> Picture:
    """The picture, made smaller if its longer side exceeds `MOST_SIDE`."""
    factor = MOST_SIDE / max(image.shape[:2])
    if factor >= 1:
        return image
    size = (max(1, round(image.shape[1] * factor)), max(1, round(image.shape[0] * factor)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
