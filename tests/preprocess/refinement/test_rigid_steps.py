"""Rigid steps against closed forms: a pivot stays where it is, small steps add up, and a step has an inverse."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from preprocess.refinement.rigid_steps import stepped

COUNT = 5


def poses_and_pivots():
    generator = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3] = Rotation.random(COUNT, generator).as_matrix()
    poses[:, :3, 3] = generator.normal(0, 0.1, (COUNT, 3)) + np.array([0, 0, 0.8])
    return poses, generator.normal(0, 0.05, (COUNT, 3)), generator.normal(0, 0.05, (COUNT, 6))


def at(poses, points):
    return np.einsum("tij,tj->ti", poses[:, :3, :3], points) + poses[:, :3, 3]


def test_a_pivot_moves_by_the_shift_alone():
    poses, pivots, steps = poses_and_pivots()
    np.testing.assert_allclose(at(stepped(poses, pivots, steps), pivots), at(poses, pivots) + steps[:, 3:], atol=1e-12)


def test_other_points_turn_about_the_pivot():
    """The definition, written out: R exp(ω) (x − p) + what the pivot moves to."""
    poses, pivots, steps = poses_and_pivots()
    points = np.random.default_rng(1).normal(0, 0.1, (COUNT, 3))
    turned = poses[:, :3, :3] @ Rotation.from_rotvec(steps[:, :3]).as_matrix()
    expected = np.einsum("tij,tj->ti", turned, points - pivots) + at(poses, pivots) + steps[:, 3:]
    np.testing.assert_allclose(at(stepped(poses, pivots, steps), points), expected, atol=1e-12)


def test_a_turn_does_not_shift_a_head_at_arms_length():
    """A turn of 1° about the camera would shift a head 0.8 m away by 14 mm."""
    poses = np.tile(np.eye(4), (1, 1, 1))
    poses[0, 2, 3] = 0.8
    step = np.array([[np.radians(1.0), 0, 0, 0, 0, 0]])
    moved = stepped(poses, np.zeros((1, 3)), step)
    np.testing.assert_allclose(moved[0, :3, 3], [0, 0, 0.8], atol=1e-12)


def test_zero_changes_nothing_and_the_input_is_kept():
    poses, pivots, steps = poses_and_pivots()
    before = poses.copy()
    stepped(poses, pivots, steps)
    np.testing.assert_array_equal(poses, before)
    np.testing.assert_allclose(stepped(poses, pivots, 0 * steps), poses, atol=1e-15)
