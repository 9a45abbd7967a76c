"""The networks on scikit-image's portrait, and the whole tracker on a dozen frames of a real clip.

Also covers `ggavatar/landmarks/crop_region.py`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.landmarks.detector import FaceDetector
from ggavatar.landmarks.tracker import LandmarkTracker
from preprocess.tracking.geometry.landmark_topology import LEFT_IRIS, RIGHT_IRIS

RIGHT_EYE, LEFT_EYE = np.array([203.4, 101.2]), np.array([247.0, 103.2])
"""Where the portrait's eyes are, px, read off the image."""

pytestmark = pytest.mark.weights


def test_the_portraits_eyes_are_found(bundle: Path) -> None:
    found = LandmarkTracker(bundle).landmarks(astronaut())
    assert found is not None and found.presence > 0.9
    assert np.linalg.norm(found.points[RIGHT_IRIS[0]] - RIGHT_EYE) < 2
    assert np.linalg.norm(found.points[LEFT_IRIS[0]] - LEFT_EYE) < 2
    assert found.blendshapes[NAMES.index("mouthSmileLeft")] > 0.4 > found.blendshapes[NAMES.index("jawOpen")]


def test_landmarks_follow_a_turned_and_shifted_image(bundle: Path) -> None:
    image = astronaut()
    first = LandmarkTracker(bundle).landmarks(image)
    assert first is not None
    matrix = cv2.getRotationMatrix2D((226, 115), 25, 0.9)
    turned = LandmarkTracker(bundle).landmarks(cv2.warpAffine(image, matrix, (512, 512)))
    assert turned is not None
    expected = first.points @ matrix[:, :2].T + matrix[:, 2]
    assert np.median(np.linalg.norm(turned.points - expected, axis=1)) < 1.5


def test_a_small_face_in_a_large_frame_is_found(bundle: Path) -> None:
    room = np.full((1600, 1200, 3), 120, np.uint8)
    room[900:1412, 300:812] = astronaut()
    face = FaceDetector(bundle).detect(room)
    assert face is not None
    assert np.linalg.norm(np.array(face.center) - [300 + 224, 900 + 120]) < 25


def test_nothing_is_found_in_an_empty_room_and_tracking_recovers(bundle: Path) -> None:
    tracker = LandmarkTracker(bundle)
    assert tracker.landmarks(astronaut()) is not None
    assert tracker.landmarks(np.full((512, 512, 3), 120, np.uint8)) is None
    assert tracker.landmarks(astronaut()) is not None


def test_the_tracker_on_a_dozen_real_frames(bundle: Path, data_folder: Path, tmp_path: Path) -> None:
    import av

    from preprocess.options import PrepOptions
    from preprocess.tracking.tracker import track

    with av.open(str(data_folder / "clips" / "talk_450.mp4")) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame, _ in zip(video.decode(video=0), range(60), strict=False)][
            ::5
        ]
    mask = np.zeros(frames[0].shape[:2], np.uint8)
    cv2.ellipse(mask, (225, 210), (120, 160), 0, 0, 360, 255, -1)
    mask[340:] = 255
    options = dataclasses.replace(PrepOptions(Path("clip"), tmp_path), models=bundle.parent, offline=True)
    found = track(frames, [mask] * len(frames), 5.0, options)
    tracking, head = found.tracking, found.head
    assert head.version == "tracked-2" and head.joint_names[:5] == ("root", "neck", "jaw", "left_eye", "right_eye")
    assert tracking.expression.shape == (12, head.expression_basis.shape[2])
    assert tracking.joint_rotations.shape == (12, len(head.parents), 3)
    assert found.report["reprojection_px"]["median"] < 1.0
    assert 700 < found.report["focal_px"] < 2000
    assert float((head.skinning_weights.sum(dim=1) - 1).abs().max()) < 1e-5
    rotations = tracking.world_to_camera[:, :3, :3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (12, 1, 1)), atol=1e-9)
