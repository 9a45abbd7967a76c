"""Several faces in one frame. Reference: where two copies of a photograph were put.

Also covers `preprocess/evidence/people.py`.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from ggavatar.landmarks.detector import FaceDetector
from ggavatar.landmarks.tracker import LandmarkTracker

pytestmark = pytest.mark.weights


@pytest.fixture(scope="module")
def bundle(models_folder):
    return models_folder / "face_landmarker.task"


@pytest.fixture(scope="module")
def two():
    """The astronaut at the left, and mirrored at 70 % at the right; and where her face is in the first."""
    from skimage.data import astronaut

    image = astronaut()
    small = cv2.resize(np.ascontiguousarray(image[:, ::-1]), None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
    canvas = np.full((512, 900, 3), 90, np.uint8)
    canvas[:, :512], canvas[: small.shape[0], 530 : 530 + small.shape[1]] = image, small
    return canvas


def test_both_are_found_and_one_is_chosen(bundle, two):
    detector = FaceDetector(bundle)
    found = [face for face in detector.detect_all(two) if face.score > 0.7]
    faces = sorted(found, key=lambda face: face.center[0])
    assert len(faces) == 2 and faces[0].side > faces[1].side
    left, top, right, bottom = faces[0].corners
    assert left < 225 < right and top < 120 < bottom
    for face in faces:
        near = detector.detect(two, near=face.center)
        assert near == face
    assert detector.detect(two) in faces


def test_the_tracker_follows_the_one_it_is_told(bundle, two):
    tracker = LandmarkTracker(bundle)
    for place, side in (((225, 120), 0), ((740, 90), 1)):
        tracker.reset()
        tracker.follow((float(place[0]), float(place[1])))
        found = tracker.landmarks(two)
        assert found is not None and bool(found.points[:, 0].mean() > 512) == bool(side)
