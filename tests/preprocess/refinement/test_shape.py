"""Corrections of depth: what they move, and that poses follow them as least squares says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from preprocess.refinement.corrections import corrections_of
from preprocess.refinement.rigid_steps import stepped
from preprocess.refinement.shape import PRIOR, ShapeModes, compensation, depth_modes, shape_step


def test_only_heads_of_our_tracker_are_corrected(ball, tracked_head):
    assert ShapeModes.of(ball) is None and ShapeModes.of(tracked_head) is not None


def test_the_face_moves_in_depth_and_the_torso_not(tracked_head):
    modes = ShapeModes.of(tracked_head)
    assert not modes.modes[:, :, :2].any()
    torso = (tracked_head.skinning_weights[:, tracked_head.joint_index("torso")] > 0.999).numpy()
    assert not modes.modes[:, torso].any() and np.abs(modes.modes[:, modes.points]).max() > 1e-3
    moved = modes.head(tracked_head, np.array([0, 1.0, 0, 0, 0, 0]))
    change = (moved.template - tracked_head.template)[:, 2].numpy()[modes.points]
    heights = tracked_head.template[:, 1].numpy()[modes.points]
    assert np.corrcoef(change, heights)[0, 1] > 0.999
    np.testing.assert_allclose(np.polyfit(heights, change, 1)[0], 0.002 / 0.08, rtol=0.02)


def test_gradients_are_pulled_back(tracked_head):
    modes, values = ShapeModes.of(tracked_head), torch.randn(6, dtype=torch.float64, requires_grad=True)
    weights = torch.randn(tracked_head.template.shape, dtype=torch.float64)
    (torch.einsum("g,gvx->vx", values, torch.from_numpy(modes.modes)) * weights).sum().backward()
    np.testing.assert_allclose(modes.pulled_back(weights.numpy()), values.grad.numpy(), rtol=1e-9)


def test_poses_follow_as_scipy_finds(ball, ball_tracking):
    """The steps that keep the projected points of a leaning face best, by another solver."""
    modes, block = depth_modes(ball), corrections_of(ball, ball_tracking).blocks[0]
    found = compensation(modes, ball, ball_tracking, block)
    points, row = ball.template.double().numpy()[modes.points], 5
    view, focal = ball_tracking.world_to_camera[row : row + 1], ball_tracking.intrinsics[row, 0, 0]
    amount = 0.05 * np.array([0, 1.0, 0, 0, 0, 0])
    leaning = points + np.einsum("g,gvx->vx", amount, modes.modes)[modes.points]

    def seen(of, step):
        pose = stepped(view, np.zeros((1, 3)), step[None] * block.units)[0]
        there = of @ pose[:3, :3].T + pose[:3, 3]
        return focal * there[:, :2] / there[:, 2:]

    start = points @ view[0, :3, :3].T + view[0, :3, 3]
    facing = -(modes.normals @ view[0, :3, :3].T * start).sum(-1) / np.linalg.norm(start, axis=-1)
    weights = np.sqrt(np.maximum(facing, 0))[:, None]
    target = seen(points, np.zeros(6))
    best = least_squares(lambda step: (weights * (seen(leaning, step) - target)).ravel(), np.zeros(6), x_scale=0.1)
    moved, expected = (seen(leaning, step) for step in (found.poses[row] @ amount, best.x))
    np.testing.assert_allclose(moved, expected, atol=0.01 * np.abs(seen(leaning, np.zeros(6)) - target).max())


def test_the_step_is_newtons(ball, ball_tracking):
    """With the quadratic of shape and pose written as one matrix, and poses eliminated."""
    modes, block = depth_modes(ball), corrections_of(ball, ball_tracking).blocks[0]
    found = compensation(modes, ball, ball_tracking, block)
    generator, rows = np.random.default_rng(0), [2, 3, 9]
    gradient, poses = generator.normal(size=6), generator.normal(size=(24, 6))
    values = generator.normal(size=6)
    information = np.eye(6) * found.scale / 2
    step, followed = shape_step(found, values, gradient, poses, information, rows)
    curvature = sum(found.information[row] for row in rows) + np.eye(6) / PRIOR**2
    along = gradient + sum(found.poses[row].T @ poses[row] for row in rows)
    np.testing.assert_allclose(curvature @ step, -(along + values / PRIOR**2), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(followed[7], found.poses[7] @ step)
    assert np.linalg.eigvalsh(found.information.mean(axis=0)).min() > -1e-6


def test_heads_without_named_torso_joints_have_modes(ball):
    nameless = dataclasses.replace(ball, joint_names=("a", "b", "c", "d", "e"))
    assert depth_modes(nameless).modes.shape == (6, len(ball.template), 3)
    assert depth_modes(nameless).modes[2].any() and pytest.approx(0) == depth_modes(nameless).modes[0, :, 0].sum()
