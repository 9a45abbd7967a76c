"""A performance is carried over to another face: by scores, by shared axes, by both. Reference: made-up persons."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from evaluate.motion.expression_transfer import carry_over
from evaluate.motion.face import SCORES, face_of
from evaluate.motion.facial_codes import with_facial_codes
from evaluate.motion.score_agreement import agreement
from evaluate.motion.transfer import TransferOptions, match_performance
from ggavatar.errors import InputError
from tests.support.performances import motion, person

NAMED = ("browInnerUp", "mouthSmileLeft", "mouthSmileRight", "mouthPucker", "jawForward", "mouthLeft")


def moving(seed: int, count: int, axes: int, amount: float = 1.0) -> np.ndarray:
    """Expressions that come and go, each by itself."""
    random = np.random.default_rng(seed)
    time = np.arange(count)[:, None] / 10
    return amount * np.clip(np.sin(time * random.uniform(0.5, 2, axes) + random.uniform(0, 6, axes)), 0, 1)


def followed(driver, target, codes) -> tuple[float, float]:
    """Correlation and slope of the scores that arrive, over the scores of named axes."""
    shown = [SCORES.index(name) for name in NAMED]
    arrived = target.scores(codes[:, : len(target.axis_names)])[:, 1:]
    found = agreement(driver.scores[:, 1:][:, shown], arrived[:, shown])
    return found.correlation, found.slope


def test_scores_arrive_whatever_the_axes_are_called() -> None:
    """No axis is shared: only the scores can tell."""
    anna, ben = person(1, NAMED, 2), person(2, NAMED, 3)
    ben = dataclasses.replace(ben, axis_names=tuple(f"ben {name}" for name in ben.axis_names))
    driver, target = anna.perform(moving(1, 200, 8)), ben.perform(moving(2, 300, 9))
    codes = carry_over(face_of(driver), face_of(target))
    correlation, slope = followed(driver, ben, codes)
    assert correlation > 0.97 and 0.85 < slope < 1.1


def test_a_small_talker_is_made_to_gape() -> None:
    """The target's clip shows a tenth of what the driver does; axes of one name tell where the rest is."""
    anna, ben = person(1, NAMED, 1), person(2, NAMED, 1)
    driver, target = anna.perform(moving(1, 200, 7)), ben.perform(moving(2, 300, 7, 0.1))
    correlation, slope = followed(driver, ben, carry_over(face_of(driver), face_of(target)))
    assert correlation > 0.9 and slope > 0.6


def test_own_axes_are_not_carried_over() -> None:
    """`own1` of two people are unrelated: moving the driver's alone, with no scores, moves nothing of the target."""
    anna, ben = person(1, NAMED, 1), person(2, NAMED, 1)
    expression = np.zeros((100, 7))
    expression[:, anna.axis_names.index("own1")] = np.sin(np.arange(100))
    driver = dataclasses.replace(anna.perform(expression), scores=None)
    target = dataclasses.replace(ben.perform(moving(2, 300, 7)), scores=None)
    assert np.ptp(carry_over(face_of(driver, 0), face_of(target)), axis=0).max() < 1e-6


def test_without_scores_shared_axes_are_copied_as_changes() -> None:
    anna, ben = person(1, NAMED, 1), person(2, NAMED, 0)
    driver = dataclasses.replace(anna.perform(moving(1, 100, 7)), scores=None)
    target = dataclasses.replace(ben.perform(moving(2, 300, 6)), scores=None)
    codes = carry_over(face_of(driver, 3), face_of(target, 5))
    for name in NAMED:
        here, there = anna.axis_names.index(name), ben.axis_names.index(name)
        change = driver.expression[:, here] - driver.expression[3, here]
        np.testing.assert_allclose(codes[:, there] - target.expression[5, there], change, atol=1e-4)


def test_nothing_in_common_is_refused() -> None:
    driver = dataclasses.replace(motion(1), head_version="pca-of-bob")
    with pytest.raises(InputError, match="has other axes; prepare both videos in the same way"):
        carry_over(face_of(driver), face_of(motion(2)))


def test_a_recording_of_scores_drives_a_face() -> None:
    ben = person(2, NAMED, 1)
    target = ben.perform(moving(2, 300, 7))
    scores = np.zeros((120, 52))
    for name, column in zip(NAMED, moving(3, 120, 6).T, strict=True):
        scores[:, 1 + SCORES.index(name)] = column
    recording = dataclasses.replace(
        motion(0, 120), expression=np.zeros((120, 0)), joint_rotations=np.zeros((120, 0, 3)), joint_names=(),
        eyelids=np.zeros((120, 2)), cameras=None, head_version="arkit", scores=scores,
    )  # fmt: skip
    for smooth in ("one-euro", "savgol", "none"):
        how = TransferOptions(smooth=smooth, margin=None)
        moved = match_performance(recording, None, target, None, how)
    correlation, slope = followed(recording, ben, moved.expression)
    assert correlation > 0.95 and slope > 0.6
    assert moved.cameras is not None and np.ptp(moved.cameras.world_to_camera, axis=0).max() == 0


def test_the_performance_moves_body_and_face() -> None:
    """Wiring of `match_performance`: the head turns as the driver's, the face is that of `carry_over`."""
    anna, ben = person(1, NAMED, 1), person(2, NAMED, 1)
    driver = dataclasses.replace(anna.perform(moving(1, 100, 7)), cameras=motion(1, 100).cameras)
    target = dataclasses.replace(ben.perform(moving(2, 100, 7)), cameras=motion(2, 100).cameras)
    how = TransferOptions(smooth="none", margin=None)
    moved = match_performance(driver, None, target, None, how)
    faces = face_of(driver), face_of(target)
    expected = with_facial_codes(target, faces[1].layout, carry_over(*faces))
    np.testing.assert_allclose(moved.expression, expected.expression)
    assert moved.cameras and driver.cameras
    views = [cameras.world_to_camera[:, :3, :3] for cameras in (moved.cameras, driver.cameras)]
    turns = [view[1:] @ view[:1].transpose(0, 2, 1) for view in views]
    np.testing.assert_allclose(turns[0], turns[1], atol=1e-9)
    limited = match_performance(driver, None, target, None, dataclasses.replace(how, margin=0.01))
    assert np.ptp(limited.expression, axis=0).max() < np.ptp(moved.expression, axis=0).max()
