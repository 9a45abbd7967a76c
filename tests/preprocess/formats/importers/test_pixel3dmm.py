"""Pixel3DMM's `.frame` files: its own projection in float64, our writer, and two real files.

Reference: tracker.py of the project: FLAME with an identity root, X = R·v + t, an OpenGL camera (`R_base_0`,
`t_base_0`), focal length fl·S and principal point (pp + 1)·(S/2 + 1/2).
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.geometry.transforms import rotation_6d_to_matrix
from ggavatar.io.restricted_pickle import read_pickle
from preprocess.formats.importers import pixel3dmm
from preprocess.formats.registry import detect_format
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record


def turned_neck(record):
    joints = record.joint_rotations.copy()
    joints[:, 1] = [[0.1, -0.2, 0.02 * row] for row in range(len(joints))]
    return dataclasses.replace(record, joint_rotations=joints)


def pixels(record, row):
    shortened = dataclasses.replace(record, expression=record.expression[:, :4])
    points = posed_vertices(ball_head(), as_tracking(shortened), row)
    return project(points, record.intrinsics[row], record.world_to_camera[row])[0]


def test_round_trip_keeps_projections(tmp_path):
    record = turned_neck(moving_record(6))
    pixel3dmm.write(tmp_path / "checkpoint", record)
    for folder in (tmp_path, tmp_path / "checkpoint"):
        assert detect_format(folder) == "pixel3dmm"
    found = pixel3dmm.read(tmp_path)
    assert (found.width, found.height) == (96, 96) and any("`cropped`" in note for note in found.notes)
    for row in range(6):
        np.testing.assert_allclose(pixels(found, row), pixels(record, row), atol=1e-3)


def projected_by_the_tracker(content, points):
    """Pixel3DMM's own formulas on points of FLAME with an identity root."""
    flame, camera = content["flame"], content["camera"]
    turn = rotation_6d_to_matrix(torch.from_numpy(flame["R"].astype(np.float64)))[0].numpy()
    world = points @ turn.T + flame["t"][0]
    seen = world @ camera["R_base_0"][0].T.astype(np.float64) + camera["t_base_0"][0]
    size = int(content["img_size"][0])
    center = (camera["pp"][0].astype(np.float64) + 1) * (size / 2 + 0.5)
    focal = float(camera["fl"][0, 0]) * size
    return np.stack((focal * seen[:, 0] / -seen[:, 2] + center[0], -focal * seen[:, 1] / -seen[:, 2] + center[1]), 1)


def test_camera_is_that_of_the_tracker(tmp_path):
    pixel3dmm.write(tmp_path, moving_record(2))
    content, found = read_pickle(tmp_path / "00001.frame"), pixel3dmm.read(tmp_path)
    points = np.random.default_rng(0).normal(0, 0.08, (40, 3))
    seen, depth = project(points, found.intrinsics[1], found.world_to_camera[1])
    np.testing.assert_allclose(seen, projected_by_the_tracker(content, points), atol=1e-4)
    assert depth.min() > 0.5


def test_real_files(data_folder):
    """Facts of spec and files: 256 px, the head 0.9 to 1.1 m away, upright, rows of R scaled, 100 expressions."""
    folder = data_folder / "tracking" / "pixel3dmm"
    assert detect_format(folder) == "pixel3dmm"
    found = pixel3dmm.read(folder)
    assert found.numbers.tolist() == [0, 1] and (found.width, found.expression.shape[1]) == (256, 100)
    assert found.shape is not None and found.shape.shape == (300,) and found.version == "flame2020"
    points = np.random.default_rng(1).normal(0, 0.08, (20, 3))
    for row in range(2):
        rotation = found.world_to_camera[row, :3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        assert rotation[1, 1] < -0.9 and 0.9 < found.world_to_camera[row, 2, 3] < 1.1
        content = read_pickle(folder / f"{row:05d}.frame")
        seen, _ = project(points, found.intrinsics[row], found.world_to_camera[row])
        np.testing.assert_allclose(seen, projected_by_the_tracker(content, points), atol=1e-3)


def test_flame_without_jaw_is_refused(tmp_path):
    record = moving_record(3)
    record.joint_rotations[:, 2] = 0
    pixel3dmm.write(tmp_path, record)
    with pytest.raises(InputError, match="use_flame2023=False"):
        pixel3dmm.read(tmp_path)


def test_what_the_format_cannot_hold(tmp_path):
    record = moving_record(2)
    with pytest.raises(InputError, match="square"):
        pixel3dmm.write(tmp_path, moving_record(2, (128, 96)))
    with pytest.raises(InputError, match="move them into the camera"):
        pixel3dmm.write(tmp_path, dataclasses.replace(record, translation=np.ones((2, 3))))


def test_a_contradictory_frame_is_left_out(tmp_path):
    pixel3dmm.write(tmp_path, moving_record(4))
    content = torch.load(tmp_path / "00002.frame", weights_only=False)
    content["flame"]["R_rotation_matrix"] = np.eye(3, dtype=np.float32)[None]
    torch.save(content, tmp_path / "00002.frame")
    found = pixel3dmm.read(tmp_path)
    assert found.numbers.tolist() == [0, 1, 3] and "'R' and 'R_rotation_matrix' to agree" in found.notes[0]
