"""Images that a data set lists in transforms.json with their time step, as a frame source (VHAP's export and UNION)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.images import image_header, read_rgb
from ggavatar.io.inner_paths import path_inside
from ggavatar.io.json_files import read_json
from preprocess.video.frame import DecodedFrame

FILES = ("transforms.json", "transforms_train.json", "transforms_val.json", "transforms_test.json")
_MAX_FRAMES = 1_000_000


def list_files(folder: Path) -> list[Path]:
    """The lists of a data set: transforms.json, or else those of its splits."""
    present = [folder / name for name in FILES if (folder / name).is_file()]
    return present[:1] if present[:1] == [folder / FILES[0]] else present


def first_camera(frames: list[Mapping[str, Any]]) -> object:
    """The camera with the lowest index; 0 where frames have none."""
    indices = {index for frame in frames if isinstance(index := frame.get("camera_index", 0), int | str)}
    return min(indices, key=lambda index: (isinstance(index, str), index), default=0)


def listed_images(folder: Path) -> dict[int, Path]:
    """Images of the first camera by time step, ascending; none if the folder has no such lists.

    Raises:
        InputError: A listed name leads out of the data set.
    """
    chosen: dict[int, Path] = {}
    lists = [(path, _frames(path)) for path in list_files(folder)]
    camera = first_camera([frame for _, frames in lists for frame in frames])
    for path, frames in lists:
        for frame in frames:
            if frame.get("camera_index", 0) == camera:
                chosen.setdefault(frame["timestep_index"], path_inside(path, frame["file_path"], siblings=True))
    return dict(sorted(chosen.items()))


def _frames(path: Path) -> list[Mapping[str, Any]]:
    """Entries with a time step and a file; none if the file lists other things."""
    try:
        frames = read_json(path).get("frames")
    except InputError:
        return []
    if not isinstance(frames, list) or len(frames) > _MAX_FRAMES:
        return []
    keep = [frame for frame in frames if isinstance(frame, dict) and type(frame.get("timestep_index")) is int]
    return [frame for frame in keep if isinstance(frame.get("file_path"), str) and frame["timestep_index"] >= 0]


class ListedImages:
    """The images of the first camera of a data set.

    Args:
        path: Folder with transforms.json.
        images: What `listed_images` found there.
        fps: Frame rate.
    """

    def __init__(self, path: Path, images: Mapping[int, Path], fps: float) -> None:
        self.path = path
        self._images, self._fps = images, fps

    def frames(self) -> Iterator[DecodedFrame]:
        """All images in order of their time steps; `InputError` if one is missing or they differ in size."""
        size: tuple[int, int] | None = None
        for row, (number, path) in enumerate(self._images.items()):
            if not path.is_file():
                raise InputError(f"{self.path}: lists {path}, which does not exist; copy the whole data set")
            header = image_header(path)
            size = size or (header.width, header.height)
            if (header.width, header.height) != size:
                found = f"{header.width}×{header.height}"
                raise InputError(f"{path}: expected {size[0]}×{size[1]} px like the first image, found {found}")
            yield DecodedFrame(number, row / self._fps, header.width, header.height, partial(read_rgb, path))

    def decode_errors(self) -> list[str]:
        """Empty: an image that cannot be read raises an error instead."""
        return []
