"""Folders of images. Reference: the images written, whose brightness tells their frame and camera."""

from __future__ import annotations

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.images import read_rgb, write_png
from preprocess.video.image_folder import ImageFolder, numbered_images


def write(folder, name, level):
    write_png(folder / f"{name}.png", np.full((8, 8, 3), level, np.uint8))


def levels(source):
    return {frame.number: int(frame.image[0, 0, 0]) for frame in source.frames()}


def test_one_camera_of_an_export_with_gaps(tmp_path):
    for frame in (0, 1, 2, 10, 11):
        for camera in range(3):
            write(tmp_path, f"{frame:05d}_{camera:02d}", 10 * frame + camera)
    first, last = ImageFolder(tmp_path, 25.0), ImageFolder(tmp_path, 25.0, camera=2)
    assert levels(first) == {0: 0, 1: 10, 2: 20, 10: 100, 11: 110}
    assert levels(last) == {0: 2, 1: 12, 2: 22, 10: 102, 11: 112}
    assert "camera 0 is used; choose another one with --camera" in first.notes[0]
    with pytest.raises(InputError, match=r"no camera 3 in the names, only 0, 1, 2; choose with --camera"):
        ImageFolder(tmp_path, 25.0, camera=3)


def test_years_and_resolutions_are_no_frame_numbers(tmp_path):
    for frame in (7, 8, 12):
        write(tmp_path, f"take2_1920x1080_{frame:04d}", frame)
    assert levels(ImageFolder(tmp_path, 25.0)) == {7: 7, 8: 8, 12: 12}


def test_positions_count_only_where_no_name_has_a_number(tmp_path):
    for name, level in (("a", 1), ("b", 2), ("c", 3)):
        write(tmp_path, name, level)
    found = numbered_images(tmp_path)
    assert found.by_position and "alphabetical order" in found.notes[0]
    assert [read_rgb(path)[0, 0, 0] for path in found.files.values()] == [1, 2, 3]
    write(tmp_path, "frame_7", 9)
    assert list(numbered_images(tmp_path).files) == [7]
