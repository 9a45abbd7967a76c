"""Corrections: zero is none, each kind moves what it says, and gradients against finite differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from preprocess.refinement.corrections import CHANGED, corrections_of, expression_components, head_origins
from preprocess.tracking.geometry.projection import posed_vertices, project


@pytest.fixture
def with_torso(ball_tracking):
    return dataclasses.replace(ball_tracking, torso_to_camera=ball_tracking.world_to_camera.copy())


def names(corrections):
    return [block.name for block in corrections.blocks]


def test_blocks_are_what_head_and_tracking_can_express(ball, ball_tracking, with_torso, tracked_head, tracked):
    assert names(corrections_of(ball, ball_tracking)) == ["head", "expression", "jaw", "gaze", "eyelids"]
    assert "torso" in names(corrections_of(ball, with_torso))
    assert "torso" in names(corrections_of(tracked_head, tracked))
    still = dataclasses.replace(ball, eyelid_basis=0 * ball.eyelid_basis)
    assert "eyelids" not in names(corrections_of(still, ball_tracking))


def test_no_correction_gives_the_tracking_itself(ball, with_torso, tracked_head, tracked):
    for head, tracking in ((ball, with_torso), (tracked_head, tracked)):
        corrections = corrections_of(head, tracking)
        same = corrections.moved(tracking, np.zeros((len(tracking.expression), corrections.count)))
        drawn = [posed_vertices(head, each, 3) for each in (same, tracking)]
        np.testing.assert_allclose(*drawn, atol=1e-6)
        np.testing.assert_allclose(same.world_to_camera, tracking.world_to_camera, atol=1e-12)
        for name in ("intrinsics", "translation"):
            np.testing.assert_array_equal(getattr(same, name), getattr(tracking, name))


def test_a_turn_of_the_head_leaves_its_origin_and_a_tracked_torso(tracked_head, tracked):
    """Of a head whose neck moves the torso, the shoulders stay where they are in the camera."""
    corrections = corrections_of(tracked_head, tracked)
    values = np.zeros((len(tracked.expression), corrections.count))
    values[:, 1] = 4.0  # 2° of yaw
    moved = corrections.moved(tracked, values)
    angle = Rotation.from_matrix(
        tracked.world_to_camera[:, :3, :3].transpose(0, 2, 1) @ moved.world_to_camera[:, :3, :3]
    ).magnitude()
    np.testing.assert_allclose(np.degrees(angle), 2.0, atol=1e-9)
    np.testing.assert_allclose(moved.world_to_camera[:, :3, 3], tracked.world_to_camera[:, :3, 3], atol=1e-12)
    torso = (tracked_head.skinning_weights[:, tracked_head.joint_index("torso")] > 0.999).numpy()
    for row in (0, 5):
        seen = [
            project(posed_vertices(tracked_head, each, row)[torso], each.intrinsics[row], each.world_to_camera[row])[0]
            for each in (tracked, moved)
        ]
        np.testing.assert_allclose(*seen, atol=0.02)


def test_pivot_is_the_heads_origin_wherever_the_tracker_moves_it(ball, ball_tracking):
    shifted = dataclasses.replace(ball_tracking, translation=ball_tracking.translation + np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(head_origins(ball, shifted), np.tile([0.1, 0.2, 0.3], (24, 1)), atol=1e-6)


def test_gradients_are_pulled_back_exactly(ball, with_torso, tracked_head, tracked):
    """Chain rule against differences of a quadratic function of the moved arrays."""
    for head, tracking in ((ball, with_torso), (tracked_head, tracked)):
        corrections, generator = corrections_of(head, tracking), np.random.default_rng(0)
        values = generator.normal(0, 0.5, (len(tracking.expression), corrections.count))
        weights = {n: generator.normal(size=a.shape) for n, a in tracking.arrays().items() if n in CHANGED}

        def cost(at, corrections=corrections, tracking=tracking, weights=weights):
            moved = corrections.moved(tracking, at).arrays()
            return sum(float((weights[name] * moved[name] ** 2).sum()) for name in weights)

        moved = corrections.moved(tracking, values).arrays()
        gradients = {name: 2 * weights[name] * moved[name] for name in weights}
        found = corrections.pulled_back(tracking, values, gradients)
        for row, column in ((0, 0), (2, 4), (5, 7), (7, corrections.count - 1), (3, 1)):
            step = np.zeros_like(values)
            step[row, column] = 1e-4
            expected = (cost(values + step) - cost(values - step)) / 2e-4
            assert found[row, column] == pytest.approx(expected, rel=1e-4, abs=1e-7)


def test_expression_components_are_main_motions_of_the_mesh(ball, ball_tracking):
    """Scaled to one deviation each, they reproduce the covariance of the codes as the mesh shows it."""
    found = expression_components(ball, ball_tracking, has_neck=False)
    basis = ball.expression_basis.double().numpy().reshape(-1, 4)
    codes = ball_tracking.expression - ball_tracking.expression.mean(axis=0)
    expected = (basis @ codes.T) @ (basis @ codes.T).T / len(codes)
    motions = basis @ found.T
    np.testing.assert_allclose(motions @ motions.T, expected, atol=1e-3 * np.abs(expected).max())
    sizes = np.linalg.norm(motions, axis=0)
    assert (np.diff(sizes) <= 1e-9).all()


def test_the_length_of_the_neck_is_no_expression(tracked_head, tracked):
    assert not expression_components(tracked_head, tracked, has_neck=True)[:, -1].any()


def test_a_clip_without_expressions_has_no_components(ball, ball_tracking):
    still = dataclasses.replace(ball_tracking, expression=0 * ball_tracking.expression)
    corrections = corrections_of(ball, still)
    assert len(corrections.expressions) == 0
    values = np.zeros((24, corrections.count))
    assert not corrections.moved(still, values).expression.any()
