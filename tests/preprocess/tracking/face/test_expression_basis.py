"""Regression and principal axes against numpy; coefficients and axes against those that generated the landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.procedural.model import procedural_names
from ggavatar.landmarks.blendshapes import NAMES
from preprocess.tracking.face.expression_basis import (
    PAIRS,
    MotionPrior,
    PosedCamera,
    column_products,
    fit_motion,
    landmark_displacements,
    principal_axes,
    refine_axes,
    ridge_regression,
    symmetric_from_upper,
)
from preprocess.tracking.geometry.landmark_model import FaceModel, FaceMotion
from preprocess.tracking.geometry.rigid import LandmarkObservations, PinholeIntrinsics, RigidPoses, project_to_pixels
from preprocess.tracking.head.expression_axes import axis_scores, generic_mixture
from preprocess.tracking.tracker import rescaled_blinks

FRAMES, POINTS, COUNT = 90, 40, 3


def synthetic() -> tuple[FaceModel, FaceMotion, PosedCamera, LandmarkObservations]:
    """A small face that moves and rotates, and its landmarks."""
    generator = np.random.default_rng(5)
    neutral = generator.uniform([-0.07, -0.09, 0.0], [0.07, 0.09, 0.07], (POINTS, 3))
    share = np.where(neutral[:, 1] < -0.02, 1.0, 0.0)
    model = FaceModel(neutral, generator.normal(0, 0.004, (POINTS, 3, COUNT)), share, np.array([0.0, -0.02, -0.01]))
    motion = FaceMotion(
        generator.normal(0, 0.5, (FRAMES, COUNT)),
        np.stack((generator.uniform(0, 0.2, FRAMES), generator.normal(0, 0.02, FRAMES)), axis=1),
    )
    angles = generator.uniform(-1, 1, (FRAMES, 3)) * [10, 25, 5]
    turns = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("xyz", angles, degrees=True)
    camera = PosedCamera(
        PinholeIntrinsics(1000.0, (256.0, 256.0)), RigidPoses(turns.as_matrix(), np.tile([0.0, 0.0, 0.9], (FRAMES, 1)))
    )
    points = project_to_pixels(camera.poses.to_camera(model.shapes(motion.coefficients, motion.jaw)), camera.intrinsics)
    return model, motion, camera, LandmarkObservations(points, np.full((FRAMES, POINTS), 1.0))


def test_regression_without_ridge_is_least_squares() -> None:
    generator = np.random.default_rng(0)
    scores, targets = generator.random((50, 4)), generator.normal(size=(50, 7, 3))
    slopes, intercept = ridge_regression(targets, scores, 0.0)
    expected = np.linalg.lstsq(np.column_stack((scores, np.ones(50))), targets.reshape(50, -1), rcond=None)[0]
    np.testing.assert_allclose(np.moveaxis(slopes, -1, 0).reshape(4, -1), expected[:4], atol=1e-6)
    np.testing.assert_allclose(intercept.ravel(), expected[4], atol=1e-6)


@pytest.mark.parametrize("frames", [60, 3])
def test_principal_axes_are_the_singular_vectors(frames: int) -> None:
    """Scaled to unit variance of their coefficients; axes beyond the number of frames are zero."""
    residuals = np.random.default_rng(1).normal(size=(frames, 5, 3)) * np.linspace(3, 0.1, 5)[:, None]
    axes, share = principal_axes(residuals, 4)
    _, values, vectors = np.linalg.svd(residuals.reshape(frames, -1), full_matrices=False)
    for column in range(min(4, frames)):
        length = values[column] / np.sqrt(frames)
        np.testing.assert_allclose(abs(axes[..., column].ravel() @ vectors[column]), length, rtol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(axes[..., column]), length, rtol=1e-9)
    assert not axes[..., frames:].any()
    np.testing.assert_allclose(share, (values[:4] ** 2).sum() / (values**2).sum(), rtol=1e-9)


def test_displacements_across_the_view_are_recovered() -> None:
    model, _, camera, _ = synthetic()
    still = model.shapes(np.zeros((FRAMES, COUNT)), np.zeros((FRAMES, 2)))
    across = np.array([0.001, -0.002, 0.0]) @ camera.poses.rotations
    points = project_to_pixels(camera.poses.to_camera(still + across[:, None]), camera.intrinsics)
    found = landmark_displacements(LandmarkObservations(points, np.ones((FRAMES, POINTS))), camera, still)
    np.testing.assert_allclose(found, np.broadcast_to(across[:, None], found.shape), atol=1e-8)


def test_coefficients_and_jaw_are_recovered() -> None:
    model, motion, camera, observed = synthetic()
    weak_prior = MotionPrior(np.zeros((FRAMES, COUNT)), np.full(COUNT, 3.0), np.zeros((FRAMES, 2)))
    found = fit_motion(observed, camera, model, weak_prior, iterations=6)
    np.testing.assert_allclose(found.coefficients, motion.coefficients, atol=0.02)
    np.testing.assert_allclose(found.jaw, motion.jaw, atol=0.01)


def test_normal_equations_by_one_product_are_those_landmark_by_landmark() -> None:
    generator = np.random.default_rng(3)
    columns, roots = generator.normal(size=(7, 3, 5)), generator.normal(size=(4, 7, 2, 3))
    information = roots.swapaxes(-1, -2) @ roots
    expected = np.einsum("nai,tnab,nbj->tij", columns, information, columns)
    packed = information[..., PAIRS[0], PAIRS[1]].reshape(4, -1)
    np.testing.assert_allclose(symmetric_from_upper(packed @ column_products(columns), 5), expected, atol=1e-12)


def test_axes_are_refined_and_fixed_ones_kept() -> None:
    model, motion, camera, observed = synthetic()
    spoiled = np.random.default_rng(2).normal(0, 0.001, model.axes.shape)
    spoiled[..., 2] = 0
    start = FaceModel(model.neutral, model.axes + spoiled, model.jaw_weights, model.jaw_pivot)
    found = refine_axes(observed, camera, start, motion, np.array([1.0, 1.0, 0.0]))
    missed = (
        project_to_pixels(camera.poses.to_camera(found.shapes(motion.coefficients, motion.jaw)), camera.intrinsics)
        - observed.points
    )
    before = (
        project_to_pixels(camera.poses.to_camera(start.shapes(motion.coefficients, motion.jaw)), camera.intrinsics)
        - observed.points
    )
    assert np.abs(missed).mean() < 0.1 * np.abs(before).mean()
    np.testing.assert_array_equal(found.axes[..., 2], start.axes[..., 2])


def test_named_axes_map_to_generic_expressions() -> None:
    names, _ = procedural_names()
    mixture = generic_mixture()
    assert mixture.shape == (len(names), len(TRACKED_AXES)) and len(TRACKED_AXES) == 37
    smile = mixture[:, TRACKED_AXES.index("mouthSmileLeft")]
    assert names[int(np.argmax(smile))] == "smile_left" and np.count_nonzero(smile) == 1
    assert mixture[names.index("mouth_shift_right"), TRACKED_AXES.index("mouthRight")] == 1
    assert not mixture[:, TRACKED_AXES.index("mouthClose")].any()
    scores = np.arange(52.0)[None]
    assert axis_scores(scores)[0, TRACKED_AXES.index("noseSneerRight")] == NAMES.index("noseSneerRight")


def test_blinks_are_rescaled_to_closed_lids_and_open_eyes_kept() -> None:
    lids = np.zeros((400, 2))
    lids[50:60] = 0.6
    scores = np.zeros((400, 52))
    scores[50:60, NAMES.index("eyeBlinkLeft")] = 0.7
    found = rescaled_blinks(lids, scores)
    np.testing.assert_allclose(found[50:60], np.tile([1.0, 0.6], (10, 1)), atol=1e-9)
    assert not found[:50].any()
