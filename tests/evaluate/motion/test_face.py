"""Rest and priors of a face, against closed forms and persons whose rest is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from evaluate.motion.face import SCORES, conditioned, expected_slopes, face_of
from evaluate.motion.facial_codes import facial_layout
from tests.support.performances import motion, person

NAMED = ("browInnerUp", "mouthSmileLeft", "mouthSmileRight", "mouthPucker")


def test_conditioning_is_the_gaussian_posterior() -> None:
    """One code of variance 4 seen with variance 1 keeps 4/5 of it; two codes by the information form."""
    np.testing.assert_allclose(conditioned(np.array([[4.0]]), np.eye(1), np.array([2.0]), np.array([1.0])), [1.6])
    covariance, observe = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([[1.0, 0.5], [0.0, 2.0], [1.0, 1.0]])
    values, variance = np.array([1.0, -2.0, 0.5]), np.array([0.5, 1.0, 2.0])
    information = np.linalg.inv(covariance) + observe.T @ np.diag(1 / variance) @ observe
    expected = np.linalg.solve(information, observe.T @ (values / variance))
    np.testing.assert_allclose(conditioned(covariance, observe, values, variance), expected, atol=1e-12)


def test_rest_is_found_in_a_clip_that_never_shows_it() -> None:
    """Every frame is a grimace of one kind or another: no frame has all codes near zero."""
    random = np.random.default_rng(5)
    anna = person(1, NAMED, 2)
    expression = np.zeros((400, 6))
    for row, chosen in enumerate(random.integers(0, 4, 400)):
        expression[row, anna.axis_names.index(NAMED[chosen])] = random.uniform(0.5, 1.0)
    face = face_of(anna.perform(expression))
    nearest = np.abs(expression).sum(axis=1).min()
    assert np.abs(face.rest[:6]).sum() < 0.5 * nearest
    rest = anna.scores(np.zeros((1, 6)))[0, 1:]
    shown = [SCORES.index(name) for name in NAMED]
    np.testing.assert_allclose(face.rest_scores[shown], rest[shown], atol=0.02)
    assert face.score_map is not None and face.score_map.correlation > 0.9


def test_a_given_frame_is_rest() -> None:
    anna = person(1, NAMED, 1)
    sequence = anna.perform(np.random.default_rng(0).uniform(0, 1, (50, 5)))
    face = face_of(sequence, 7)
    np.testing.assert_array_equal(face.rest[:5], sequence.expression[7])
    assert sequence.scores is not None
    np.testing.assert_array_equal(face.rest_scores, sequence.scores[7, 1:])
    blind = face_of(dataclasses.replace(sequence, scores=None), 7)
    assert blind.score_map is None and not blind.rest_scores.any()


def test_frames_without_a_face_teach_nothing() -> None:
    anna = person(1, NAMED, 1)
    sequence = anna.perform(np.random.default_rng(0).uniform(0, 1, (60, 5)))
    assert sequence.scores is not None
    holed = sequence.scores.copy()
    holed[::7] = np.nan
    whole, part = face_of(sequence), face_of(dataclasses.replace(sequence, scores=holed))
    assert part.score_map is not None and np.isfinite(part.rest).all()
    np.testing.assert_allclose(part.rest, whole.rest, atol=0.1)


def test_named_codes_are_expected_to_move_their_scores() -> None:
    sequence = dataclasses.replace(motion(1), axis_names=("browInnerUp", "own1", "mouthLeft", "neckLength"))
    slopes = expected_slopes(facial_layout(sequence))
    moved = {(SCORES[score], column) for score, column in zip(*np.nonzero(slopes), strict=True)}
    names = facial_layout(sequence).names
    assert {(score, names[column]) for score, column in moved} == {
        ("browInnerUp", "browInnerUp"),
        ("mouthLeft", "mouthLeft"),
        ("jawOpen", "joint jaw 0"),
        ("eyeBlinkLeft", "lid left"),
        ("eyeBlinkRight", "lid right"),
    }


@pytest.mark.parametrize("count", [2, 3])
def test_very_short_clips_have_a_face(count: int) -> None:
    anna = person(1, NAMED, 1)
    face = face_of(anna.perform(np.random.default_rng(0).uniform(0, 1, (count, 5))))
    assert np.isfinite(face.rest).all() and np.isfinite(face.covariance).all()


def test_a_single_frame_without_scores_has_a_face() -> None:
    anna = person(1, NAMED, 1)
    still = dataclasses.replace(anna.perform(np.random.default_rng(0).uniform(0, 1, (1, 5))), scores=None)
    face = face_of(still)
    np.testing.assert_array_equal(face.rest[:5], still.expression[0])
    assert np.isfinite(face.covariance).all()
