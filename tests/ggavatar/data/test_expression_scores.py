"""Scores of a capture come from its stored landmarks, or from its images. Reference: the networks themselves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ggavatar.data.expression_scores import faces_in, measured_scores, scores_of
from ggavatar.landmarks.blendshapes import BlendshapeNetwork
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable
from tests.support.toy_run import COUNT, write_capture


def test_without_the_network_there_are_no_scores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = write_capture(tmp_path / "capture")
    finder = ModelFinder(offline=True)

    def unavailable(name: str) -> Path:
        raise ModelUnavailable(f"{name} is not here")

    monkeypatch.setattr(finder, "find", unavailable)
    assert measured_scores(capture, capture.frames, finder) is None


def test_stored_landmarks_are_scored(tmp_path: Path, pretrained: Callable[[str], Path]) -> None:
    """Landmarks of some frames only; those without are unknown."""
    bundle = pretrained("face_landmarker")
    capture = write_capture(tmp_path / "capture")
    points = np.random.default_rng(0).uniform(0, 20, (COUNT, 478, 2)).astype(np.float32)
    points[3] = np.nan
    capture = dataclasses.replace(capture, tracking=dataclasses.replace(capture.tracking, landmarks=points))
    chosen = [capture.frames[row] for row in (1, 3, 5)]
    found = measured_scores(capture, chosen, ModelFinder(bundle.parent, offline=True))
    assert found is not None and np.isnan(found[1]).all()
    network = BlendshapeNetwork(bundle)
    np.testing.assert_array_equal(found[[0, 2]], [network.scores(points[1]), network.scores(points[5])])


def test_images_without_faces_give_no_scores(tmp_path: Path, pretrained: Callable[[str], Path]) -> None:
    bundle = pretrained("face_landmarker")
    capture = write_capture(tmp_path / "capture")
    finder = ModelFinder(bundle.parent, offline=True)
    assert measured_scores(capture, capture.frames, finder) is None


def test_images_are_looked_at_one_by_one() -> None:
    """The tracker forgets between images, or it would follow the face of another moment."""

    class Tracker(LandmarkTracker):
        def __init__(self) -> None:
            self.calls: list[str] = []

        def reset(self) -> None:
            self.calls.append("reset")

        def landmarks(self, frame: np.ndarray) -> None:
            self.calls.append("look")

    tracker = Tracker()
    found = scores_of(faces_in(iter([np.zeros((8, 8, 3), np.uint8)] * 2), tracker))
    assert tracker.calls == ["reset", "look"] * 2 and found.shape == (2, 52) and np.isnan(found).all()


def test_one_face_is_not_enough_to_learn_from(tmp_path: Path, pretrained: Callable[[str], Path]) -> None:
    bundle = pretrained("face_landmarker")
    capture = write_capture(tmp_path / "capture")
    points = np.full((COUNT, 478, 2), np.nan, np.float32)
    points[2] = np.random.default_rng(0).uniform(0, 20, (478, 2))
    capture = dataclasses.replace(capture, tracking=dataclasses.replace(capture.tracking, landmarks=points))
    finder = ModelFinder(bundle.parent, offline=True)
    assert measured_scores(capture, capture.frames, finder) is None
