"""Bundle adjustment on a synthetic clip with known focal length, shape and poses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from preprocess.tracking.geometry.rigid import Lens, Observations, Poses, initial_poses, project
from preprocess.tracking.pose import bundle_adjustment
from preprocess.tracking.pose.bundle_adjustment import Adjusted, ShapePrior, adjust, prior_focal


@pytest.mark.parametrize("focal", [800.0, 1300.0])
def test_recovers_focal_length_shape_and_poses_of_a_turning_head(stand_in, focal: float) -> None:
    generator = np.random.default_rng(0)
    face, _ = stand_in
    prior = ShapePrior.around(face.vertices)
    shape = prior.mean + prior.modes @ generator.normal(0, 1, (prior.modes.shape[1], 3))
    angles = generator.uniform(-1, 1, (60, 3)) * [20, 35, 8]
    turns = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("xyz", angles, degrees=True)
    distance = 0.7
    true = Poses(turns.as_matrix(), np.column_stack((generator.normal(0, 0.03, (60, 2)), np.full(60, distance))))
    lens = Lens(focal, (256.0, 256.0))
    points = project(true.to_camera(shape[None]), lens) + generator.normal(0, 0.3, (60, 468, 2))
    observed = Observations(points, np.full((60, 468), 1 / 2.0**2))
    start = Lens(1.6 * focal, lens.center)
    first = initial_poses(observed, prior.mean, start)
    found = adjust(observed, prior, Adjusted(start, prior.mean, first, 0.0))
    assert found.lens.focal == pytest.approx(focal, rel=0.05)
    turned = Rotation.from_matrix(found.poses.rotations.transpose(0, 2, 1) @ true.rotations)
    apart = turned * turned.mean().inv()
    assert np.degrees(apart.magnitude()).max() < 1.0
    assert 0 < found.focal_spread < bundle_adjustment.DISTANCE_SPREAD


def test_without_evidence_the_prior_decides(stand_in) -> None:
    """A head that never turns says nothing about focal length; the prior's stays."""
    face, _ = stand_in
    prior = ShapePrior.around(face.vertices)
    facing = np.tile(Rotation.from_euler("x", 180, degrees=True).as_matrix(), (5, 1, 1))
    poses = Poses(facing, np.tile([0.0, 0.0, 1.0], (5, 1)))
    lens = Lens(1000.0, (256.0, 256.0))
    observed = Observations(project(poses.to_camera(prior.mean[None]), lens), np.full((5, 468), 1 / 30.0**2))
    start = Adjusted(Lens(1150.0, lens.center), prior.mean, initial_poses(observed, prior.mean, lens), 0.0)
    found = adjust(observed, prior, start)
    assert found.lens.focal == pytest.approx(1150.0, rel=0.1)
    held = adjust(observed, prior, start, hold_focal=True)
    assert held.lens.focal == 1150.0 and held.focal_spread == 0.0


def test_prior_focal_puts_the_face_at_the_typical_distance() -> None:
    poses = Poses(np.tile(np.eye(3), (3, 1, 1)), np.array([[0, 0, 2.0], [0, 0, 2.2], [0, 0, 2.4]]))
    assert prior_focal(poses, Lens(2200.0, (0.0, 0.0))) == pytest.approx(1000.0 * bundle_adjustment.TYPICAL_DISTANCE)
