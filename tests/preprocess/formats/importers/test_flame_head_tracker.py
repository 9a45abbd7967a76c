"""flame-head-tracker's npz files: its camera by its own construction, our writer, and its images as INPUT.

Reference: utils/graphics_utils.py of the project, Rz(roll)·Ry(yaw)·Rx(pitch) and the position as camera-to-world in
OpenGL's axes, K for 256 px with its center at 128. Also covers `preprocess/video/stored_images.py`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.importers import flame_head_tracker
from preprocess.formats.registry import detect_format
from preprocess.tracking.geometry.projection import posed_vertices, project
from preprocess.video.sources import open_source
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record


def posed(count):
    record = moving_record(count, (256, 256))
    joints = record.joint_rotations.copy()
    joints[:, 1] = [0.1, -0.05, 0.02]
    return dataclasses.replace(record, joint_rotations=joints, eyelids=np.zeros((count, 2)))


def pixels(record, row):
    record = dataclasses.replace(record, expression=record.expression[:, :4])
    points = posed_vertices(ball_head(), as_tracking(record), row)
    return project(points, record.intrinsics[row], record.world_to_camera[row])[0]


def test_round_trip_keeps_projections(tmp_path):
    record = posed(6)
    flame_head_tracker.write(tmp_path, record)
    assert detect_format(tmp_path) == "flame_head_tracker" and (tmp_path / "5.npz").is_file()
    found = flame_head_tracker.read(tmp_path)
    for row in range(6):
        np.testing.assert_allclose(pixels(found, row), pixels(record, row), atol=1e-3)


def axis_rotation(axis, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    matrices = {
        "x": [[1, 0, 0], [0, cos, -sin], [0, sin, cos]],
        "y": [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]],
        "z": [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]],
    }
    return np.array(matrices[axis])


def test_camera_is_that_of_the_tracker(tmp_path):
    flame_head_tracker.write(tmp_path, posed(2))
    yaw, pitch, roll, pose = 0.4, -0.2, 0.1, np.array([0.1, 0.02, 0.9])
    values = read_npz(tmp_path / "0.npz") | {"cam": np.array([[yaw, pitch, roll, *pose]])}
    write_npz(tmp_path / "0.npz", values)
    found = flame_head_tracker.read(tmp_path)
    turn = axis_rotation("z", roll) @ axis_rotation("y", yaw) @ axis_rotation("x", pitch)
    points = np.random.default_rng(0).normal(0, 0.05, (20, 3))
    seen = (points - pose) @ turn  # OpenGL: x right, y up, looking along −z
    focal, center = values["K"][0, 0, 0], values["K"][0, :2, 2]
    expected = center + focal * np.stack((seen[:, 0], -seen[:, 1]), 1) / -seen[:, 2:]
    np.testing.assert_allclose(project(points, found.intrinsics[0], found.world_to_camera[0])[0], expected, atol=1e-9)


def test_images_are_read_from_the_same_folder(tmp_path):
    """Frames 0 to 3 with a gap at 2; file 3 lost its image."""
    flame_head_tracker.write(tmp_path, posed(5))
    (tmp_path / "2.npz").unlink()
    images = {number: np.full((1, 64, 64, 3), 10 * number, np.uint8) for number in (0, 1, 4)}
    for number, image in images.items():
        write_npz(tmp_path / f"{number}.npz", read_npz(tmp_path / f"{number}.npz") | {"img": image})
    source = open_source(tmp_path)
    frames = list(source.frames())
    assert [frame.number for frame in frames] == [0, 1, 4] and "3.npz" in source.decode_errors()[0]
    for frame in frames:
        np.testing.assert_array_equal(frame.image, images[frame.number][0])
        assert (frame.width, frame.height) == (64, 64)
    assert flame_head_tracker.read(tmp_path).numbers.tolist() == [0, 1, 3, 4]


@pytest.mark.parametrize("value", [np.zeros((2, 8, 8, 3), np.uint8), np.zeros((8, 8), np.uint8), np.zeros((8, 8, 3))])
def test_other_images_are_left_out(tmp_path, value):
    for number in range(2):
        write_npz(tmp_path / f"{number}.npz", {"img": value})
    source = open_source(tmp_path)
    assert not list(source.frames()) and len(source.decode_errors()) == 2


def test_what_cannot_be_read(tmp_path):
    flame_head_tracker.write(tmp_path, posed(4))
    values = read_npz(tmp_path / "1.npz")
    write_npz(tmp_path / "1.npz", values | {"K": values["K"] * 4})
    found = flame_head_tracker.read(tmp_path)
    assert found.numbers.tolist() == [0, 2, 3] and "principal point at 516 px" in found.notes[0]
    with pytest.raises(InputError, match="square"):
        flame_head_tracker.write(tmp_path, moving_record(2, (128, 96)))
