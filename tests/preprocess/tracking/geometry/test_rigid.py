"""Poses against those that generated the landmarks; smoothing against its closed-form transfer function."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    PinholeIntrinsics,
    RigidPoses,
    initial_poses,
    nearest_true_index,
    pose_jacobian,
    project_to_pixels,
    projection_jacobian,
    refine_poses,
    smooth_steps,
)
from preprocess.tracking.geometry.smoothing import jitter, penalty, pose_jitter, smooth

INTRINSICS = PinholeIntrinsics(1000.0, (256.0, 256.0))


def performance(frames: int, seed: int = 0) -> tuple[np.ndarray, RigidPoses]:
    """A rigid point cloud of a head's size and slow head motion about one meter away."""
    generator = np.random.default_rng(seed)
    shape = generator.uniform([-0.07, -0.09, 0.0], [0.07, 0.09, 0.07], (120, 3))
    time = np.arange(frames) / 25
    angles = np.stack((8 * np.sin(2.1 * time), 25 * np.sin(1.3 * time + 1), 6 * np.sin(1.7 * time)), axis=1)
    turns = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("xyz", angles, degrees=True)
    shifts = np.stack((0.02 * np.sin(time), 0.01 * np.cos(1.4 * time), 1 + 0.05 * np.sin(0.7 * time)), axis=1)
    return shape, RigidPoses(turns.as_matrix(), shifts)


def errors(found: RigidPoses, true: RigidPoses) -> np.ndarray:
    """Angles between rotations, degrees."""
    return np.degrees(Rotation.from_matrix(found.rotations.transpose(0, 2, 1) @ true.rotations).magnitude())


def test_jacobian_against_finite_differences() -> None:
    shape, poses = performance(2)
    seen = poses.to_camera(shape[None])
    slopes = pose_jacobian(seen, poses, projection_jacobian(seen, INTRINSICS.focal))
    for column in range(6):
        step = np.zeros((2, 6))
        step[:, column] = 1e-6
        ahead = project_to_pixels(poses.moved(step).to_camera(shape[None]), INTRINSICS)
        behind = project_to_pixels(poses.moved(-step).to_camera(shape[None]), INTRINSICS)
        np.testing.assert_allclose(slopes[..., column], (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-3)


def test_poses_survive_outliers_and_missing_frames() -> None:
    generator = np.random.default_rng(1)
    shape, true = performance(60)
    points = project_to_pixels(true.to_camera(shape[None]), INTRINSICS) + generator.normal(0, 0.3, (60, 120, 2))
    wrong = generator.random((60, 120)) < 0.15
    points[wrong] += generator.normal(0, 60, (int(wrong.sum()), 2))
    weights = np.full((60, 120), 1 / 0.3**2)
    weights[20:23] = 0.0
    observed = LandmarkObservations(points, weights)
    found = refine_poses(observed, shape, INTRINSICS, initial_poses(observed, shape, INTRINSICS), 0.1, iterations=25)
    seen = weights[:, 0] > 0
    assert errors(found, true)[seen].max() < 0.5
    assert errors(found, true)[~seen].max() < 2.0
    assert np.abs(found.translations - true.translations)[seen].max() < 0.02


def test_smoothing_poses_steadies_them_without_lag() -> None:
    generator = np.random.default_rng(2)
    shape, true = performance(80)
    points = project_to_pixels(true.to_camera(shape[None]), INTRINSICS) + generator.normal(0, 2.0, (80, 1, 2))
    points += generator.normal(0, 2.0, points.shape)
    observed = LandmarkObservations(points, np.full((80, 120), 0.25))
    rough = refine_poses(observed, shape, INTRINSICS, initial_poses(observed, shape, INTRINSICS))
    steady = refine_poses(observed, shape, INTRINSICS, rough, penalty(3.0, 25.0))
    assert pose_jitter(steady)["rotation_deg"] < 0.5 * pose_jitter(rough)["rotation_deg"]
    assert errors(steady, true).mean() < errors(rough, true).mean()
    backwards = LandmarkObservations(points[::-1], observed.weights)
    mirrored = refine_poses(backwards, shape, INTRINSICS, rough[np.arange(80)[::-1]], penalty(3.0, 25.0), iterations=20)
    forwards = refine_poses(observed, shape, INTRINSICS, rough, penalty(3.0, 25.0), iterations=20)
    np.testing.assert_allclose(mirrored.rotations[::-1], forwards.rotations, atol=1e-4)


@pytest.mark.parametrize("cutoff", [1.0, 3.0])
def test_whittaker_halves_a_sine_of_the_cutoff_frequency(cutoff: float) -> None:
    time = np.arange(1000) / 25
    wave = np.sin(2 * np.pi * cutoff * time)[:, None]
    kept = smooth(wave, np.ones(1000), penalty(cutoff, 25.0))[200:800]
    assert np.std(kept) / np.std(wave[200:800]) == pytest.approx(0.5, abs=0.01)
    assert np.corrcoef(kept[:, 0], wave[200:800, 0])[0, 1] > 0.9999


def test_whittaker_keeps_lines_and_fills_gaps() -> None:
    line = np.stack((np.linspace(0, 5, 40), np.full(40, 2.0)), axis=1)
    weights = np.ones(40)
    weights[10:15] = 0
    spoiled = line.copy()
    spoiled[10:15] = np.nan
    np.testing.assert_allclose(smooth(spoiled, weights, 7.0), line, atol=1e-6)


def test_jitter_of_white_noise_is_its_deviation_and_of_slow_motion_nothing() -> None:
    noise = np.random.default_rng(0).normal(0, 0.3, (20000, 1))
    assert jitter(noise) == pytest.approx(0.3, rel=0.05)
    assert jitter(np.sin(np.arange(500) / 40)[:, None]) < 1e-6


def test_nearest_true() -> None:
    flags = np.array([False, True, False, False, False, True, False])
    assert nearest_true_index(flags).tolist() == [1, 1, 1, 1, 5, 5, 5]


def test_poses_are_smoothed_where_the_median_of_their_information_is_indefinite() -> None:
    """Three positive semidefinite matrices whose entrywise median has the eigenvalue −1 (numpy.linalg.eigvalsh)."""
    single = np.zeros((3, 6, 6))
    for index, signs in enumerate(([1, 1, -1], [1, -1, 1], [-1, 1, 1])):
        single[index, :3, :3] = np.outer(signs, signs)
        single[index, 3:, 3:] = np.eye(3)
    information = np.tile(single, (5, 1, 1))
    assert np.linalg.eigvalsh(np.median(information, axis=0)).min() < -0.9
    count = len(information)
    poses = RigidPoses(np.tile(np.eye(3), (count, 1, 1)), np.tile([0.0, 0.0, 1.0], (count, 1)))
    steps = smooth_steps(information, np.zeros((count, 6)), poses, 10.0)
    np.testing.assert_allclose(steps, 0.0, atol=1e-9)
