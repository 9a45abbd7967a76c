"""Measures of a reenactment, against closed forms and scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evaluate.reenactment.fidelity import head_rotation, landmark_jitter, pose_distance, score_fidelity

RANDOM = np.random.default_rng(1)


def test_a_quarter_of_the_expression_has_a_slope_of_a_quarter() -> None:
    driver = RANDOM.uniform(0, 1, (40, 5))
    found = score_fidelity(driver, 0.25 * driver + 0.3)
    np.testing.assert_allclose([found.agreement.correlation, found.agreement.slope], [1.0, 0.25])
    np.testing.assert_allclose(found.expression_distance, np.abs(0.3 - 0.75 * driver).mean())


def test_frames_without_a_face_do_not_count() -> None:
    driver, avatar = RANDOM.uniform(0, 1, (10, 4)), RANDOM.uniform(0, 1, (10, 4))
    holed = avatar.copy()
    holed[3] = np.nan
    kept = np.arange(10) != 3
    whole, part = score_fidelity(driver, holed), score_fidelity(driver[kept], avatar[kept])
    assert (whole.agreement.slope, whole.expression_distance) == (part.agreement.slope, part.expression_distance)
    with pytest.raises(ValueError, match="two frames or more"):
        score_fidelity(driver[:1], avatar[:1])


def test_poses_are_compared_about_their_means() -> None:
    turns = Rotation.from_rotvec(RANDOM.normal(0, 0.2, (30, 3)))
    seated = Rotation.from_rotvec([0.0, 0.4, 0.1])
    np.testing.assert_allclose(pose_distance((turns * seated).as_matrix(), turns.as_matrix()), 0, atol=1e-6)
    swing = Rotation.from_rotvec(np.radians([[0, 10, 0], [0, -10, 0]] * 15))
    np.testing.assert_allclose(pose_distance(swing.as_matrix(), Rotation.identity(30).as_matrix()), 10, atol=1e-9)


def test_jitter_is_the_second_difference() -> None:
    """x = t² has a second difference of 2 everywhere; over a distance of the eyes of 4 that is 0.5."""
    time = np.arange(6.0)
    points = np.zeros((6, 3, 2))
    points[:, :, 0] = time[:, None] ** 2 + [0, 4, 9]
    assert landmark_jitter(points, tuple(range(6)), (0, 1)) == pytest.approx(0.5)
    assert landmark_jitter(points, (0, 2, 4, 6, 8, 10), (0, 1)) is None
    points[2] = np.nan
    assert landmark_jitter(points, tuple(range(6)), (0, 1)) == pytest.approx(0.5)


def test_the_heads_rotation_is_found_from_landmarks() -> None:
    face = RANDOM.normal(size=(50, 3))
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    seen = 120 * face @ turn.T + [200, 150, 10]
    np.testing.assert_allclose(head_rotation(seen, face), turn, atol=1e-9)
    assert np.linalg.det(head_rotation(seen * [1, 1, -1], face)) > 0
