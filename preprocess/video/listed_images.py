"""Images that a data set lists in transforms.json with their time step (VHAP's export and UNION)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.inner_paths import path_inside
from ggavatar.io.json_files import read_json

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
        InputError: A listed name leads out of the data set, or the image does not exist.
    """
    chosen: dict[int, Path] = {}
    lists = [(path, _frames(path)) for path in list_files(folder)]
    camera = first_camera([frame for _, frames in lists for frame in frames])
    for path, frames in lists:
        for frame in frames:
            if frame.get("camera_index", 0) == camera:
                chosen.setdefault(frame["timestep_index"], path_inside(path, frame["file_path"], siblings=True))
    for image in chosen.values():
        if not image.is_file():
            raise InputError(f"{folder}: lists {image}, which does not exist; copy the whole data set")
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
