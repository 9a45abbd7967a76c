"""The whole road from a video with another tracker's output to a capture, on a made-up subject whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_subject import draw

from ggavatar.capture import Capture
from preprocess.cli import main


@pytest.fixture(scope="module")
def capture(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("road") / "capture"
    assert main([*clip.arguments, "-o", str(folder)]) == 0
    return Capture.open(folder)


def test_capture_has_the_known_tracking(capture, clip):
    assert capture.frames == tuple(range(24))
    assert (capture.width, capture.height, capture.fps) == (96, 96, 25.0)
    np.testing.assert_allclose(capture.tracking.intrinsics, clip.record.intrinsics, rtol=1e-6)
    np.testing.assert_allclose(capture.tracking.world_to_camera, clip.record.world_to_camera, atol=1e-6)
    np.testing.assert_allclose(capture.tracking.expression, clip.record.expression, atol=1e-6)
    np.testing.assert_allclose(capture.tracking.joint_rotations, clip.record.joint_rotations, atol=1e-6)


def test_capture_has_the_known_pixels(capture, clip):
    for number in (0, 11, 23):
        image, mask = draw(clip.head, clip.record, number)
        np.testing.assert_array_equal(capture.mask(number), mask)
        assert np.abs(capture.image(number).astype(int) - image).mean() < 6
