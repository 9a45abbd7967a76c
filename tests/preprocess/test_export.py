"""Captures in others' layouts, read back by their importers: the same points project to the same pixels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.io.images import image_header, read_rgb
from preprocess import export
from preprocess.cli.prep import main
from preprocess.export import (
    center_principal_point,
    export_flash_avatar,
    export_gaussian_avatars,
    with_pose_in_camera,
    with_pose_in_flame,
)
from preprocess.formats.importers import metrical_tracker, vhap
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, make_clip, moving_record


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    clip = make_clip(tmp_path_factory.mktemp("export"), count=10)
    folder = tmp_path_factory.mktemp("capture") / "c"
    assert main([*clip.arguments, "-o", str(folder)]) == 0
    return Capture.open(folder)


def pixels(record, row, head=None):
    head = head or ball_head()
    record = dataclasses.replace(record, expression=record.expression[:, :4])
    return project(posed_vertices(head, as_tracking(record), row), record.intrinsics[row], record.world_to_camera[row])[
        0
    ]


def test_pose_moves_between_camera_and_flame():
    head, record = ball_head(), moving_record(6)
    moved = with_pose_in_flame(record, head)
    assert np.ptp(moved.world_to_camera, axis=0).max() == 0 and moved.world_to_camera[0, 2, 3] == 1.0
    back = with_pose_in_camera(moved, head)
    np.testing.assert_allclose(back.world_to_camera, record.world_to_camera, atol=1e-9)
    for row in range(6):
        still = dataclasses.replace(record, eyelids=0 * record.eyelids)
        turned = dataclasses.replace(moved, eyelids=0 * moved.eyelids)
        np.testing.assert_allclose(pixels(turned, row), pixels(still, row), atol=1e-3)


def test_rotated_neck_is_refused():
    record = moving_record(2)
    record.joint_rotations[:, 1, 1] = 0.3
    with pytest.raises(InputError, match="neck joint is rotated"):
        with_pose_in_camera(record, ball_head())


def test_principal_point_is_centred_with_the_pixels():
    record = moving_record(2, (96, 80))
    record.intrinsics[:, 0, 2] += 5
    found, crop = center_principal_point(record)
    assert abs(found.intrinsics[0, 0, 2] - 48) <= 0.5 and abs(found.intrinsics[0, 1, 2] - 40) <= 0.5
    image = np.zeros((80, 96, 3), np.uint8)
    image[30, 50] = 255
    assert crop.image(image)[30 - crop.y, 50 - crop.x, 0] == 255


def test_gaussian_avatars_layout(capture, tmp_path):
    report = export_gaussian_avatars(capture, tmp_path / "ga")
    found = vhap.read(tmp_path / "ga")
    names = ("transforms_train.json", "transforms_val.json", "transforms_test.json", "canonical_flame_param.npz")
    assert all((tmp_path / "ga" / name).is_file() for name in names)
    assert report["frames"] == 10 and any("eyelids" in str(note) for note in report["notes"])
    assert image_header(tmp_path / "ga" / "images" / "00009_00.png")[:2] == (96, 96)
    assert (read_rgb(tmp_path / "ga" / "images" / "00000_00.png")[0, 0] == 255).all()
    expected = center_principal_point(export.to_tracking_record(capture))[0]
    lidless = dataclasses.replace(expected, eyelids=0 * expected.eyelids)
    for row in range(10):
        np.testing.assert_allclose(pixels(found, row), pixels(lidless, row), atol=1e-3)
    with pytest.raises(InputError, match="exists already"):
        export_gaussian_avatars(capture, tmp_path / "ga")


def test_flash_avatar_layout(capture, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="512 × 512"):
        export_flash_avatar(capture, tmp_path / "fa")
    monkeypatch.setattr(export, "FLASH_AVATAR_SIDE", 96)
    with pytest.raises(InputError, match="more than 500 frames"):
        export_flash_avatar(capture, tmp_path / "fa")
    monkeypatch.setattr(export, "FLASH_AVATAR_TEST_FRAMES", 5)
    export_flash_avatar(capture, tmp_path / "fa")
    found = metrical_tracker.read(tmp_path / "fa" / "checkpoint")
    assert sorted(path.name for path in (tmp_path / "fa" / "imgs").iterdir())[0] == "00001.jpg"
    assert len(list((tmp_path / "fa" / "alpha").iterdir())) == 10 == len(found.numbers) and found.numbers[0] == 0
    expected = center_principal_point(export.to_tracking_record(capture))[0]
    for row in range(10):
        np.testing.assert_allclose(pixels(found, row), pixels(expected, row), atol=1e-3)
