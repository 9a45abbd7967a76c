"""The landmark term: nothing where the mesh fits, its gradient against differences, and its information."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from preprocess.refinement.corrections import corrections_of
from preprocess.refinement.landmarks import LandmarkTerm
from preprocess.tracking.geometry.projection import posed_vertices, project


@pytest.fixture(scope="module")
def seen(ball, ball_tracking):
    """The ball's tracking with the landmarks of its mesh as detected, all 2 px too far right; none in frame 5."""
    corners = ball.regions["landmarks"].view(-1, 3).numpy()
    points = []
    for row in range(24):
        middle = posed_vertices(ball, ball_tracking, row)[corners].mean(axis=1)
        points.append(project(middle, ball_tracking.intrinsics[row], ball_tracking.world_to_camera[row])[0])
    landmarks = np.stack(points) + np.array([2.0, 0.0])
    landmarks[5] = np.nan
    return dataclasses.replace(ball_tracking, landmarks=landmarks)


def test_heads_and_trackings_without_landmarks_have_no_term(ball, ball_tracking, seen):
    assert LandmarkTerm.of(ball, ball_tracking) is None
    assert LandmarkTerm.of(dataclasses.replace(ball, landmark_weights=None), seen) is None
    nowhere = dataclasses.replace(seen, landmarks=np.full_like(seen.landmarks, np.nan))
    assert LandmarkTerm.of(ball, nowhere) is None


def test_a_miss_of_the_mesh_in_all_frames_is_not_held_against_a_frame(ball, seen):
    term = LandmarkTerm.of(ball, seen)
    assert term.found.tolist() == [row != 5 for row in range(24)]
    for row in (0, 7):
        np.testing.assert_allclose(term.wanted[row], term.seen(seen, row), atol=1e-3)
    corrections = corrections_of(ball, seen)
    slopes = corrections.pulled_back(seen, np.zeros((24, corrections.count)), term.gradients(seen, range(24)))
    assert np.abs(slopes).max() < 1e-3


def test_gradient_and_information_against_differences(ball, seen):
    """The misfit, written out, is half the squared misses over the scale where they are small."""
    term, corrections = LandmarkTerm.of(ball, seen), corrections_of(ball, seen)
    start = np.zeros((24, corrections.count))
    start[7, [0, 4, 6]] = [0.8, -1.5, 0.4]

    def cost(values):
        missed = (term.seen(corrections.moved(seen, values), 7) - term.wanted[7]) / term.scale
        return float((np.sqrt(1 + (missed**2).sum(-1)) - 1).sum())

    found = corrections.pulled_back(seen, start, term.gradients(corrections.moved(seen, start), range(24)))
    steps = 0.05 * np.eye(corrections.count)
    for column in range(corrections.count):
        step = np.zeros_like(start)
        step[7] = steps[column]
        assert found[7, column] == pytest.approx((cost(start + step) - cost(start - step)) / 0.1, rel=0.02, abs=2e-4)
    assert not found[5].any()
    information = term.information(seen, corrections, np.zeros_like(start), [7])
    for column in (0, 1, 4):
        step = np.zeros_like(start)
        step[7] = 0.2 * steps[column]
        assert 2 * cost(step) / 0.01**2 == pytest.approx(information[column, column], rel=0.05)


def test_frames_without_landmarks_tell_nothing(ball, seen):
    term, corrections = LandmarkTerm.of(ball, seen), corrections_of(ball, seen)
    assert not term.information(seen, corrections, np.zeros((24, corrections.count)), [5]).any()
