"""Bundle adjustment on a synthetic clip with known focal length, shape and poses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry.landmark_embedding import LandmarkEmbedding
from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    PinholeIntrinsics,
    RigidPoses,
    initial_poses,
    project_to_pixels,
)
from preprocess.tracking.pose import bundle_adjustment
from preprocess.tracking.pose.bundle_adjustment import BundleEstimate, ShapePrior, bundle_adjust, prior_focal

StandIn = tuple[CanonicalFace, LandmarkEmbedding]


@pytest.mark.parametrize("focal", [800.0, 1300.0])
def test_recovers_focal_length_shape_and_poses_of_a_turning_head(stand_in: StandIn, focal: float) -> None:
    generator = np.random.default_rng(0)
    face, _ = stand_in
    prior = ShapePrior.from_canonical(face.vertices)
    shape = prior.mean + prior.modes @ generator.normal(0, 1, (prior.modes.shape[1], 3))
    angles = generator.uniform(-1, 1, (60, 3)) * [20, 35, 8]
    turns = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("xyz", angles, degrees=True)
    distance = 0.7
    true = RigidPoses(turns.as_matrix(), np.column_stack((generator.normal(0, 0.03, (60, 2)), np.full(60, distance))))
    intrinsics = PinholeIntrinsics(focal, (256.0, 256.0))
    points = project_to_pixels(true.to_camera(shape[None]), intrinsics) + generator.normal(0, 0.3, (60, 468, 2))
    observed = LandmarkObservations(points, np.full((60, 468), 1 / 2.0**2))
    start = PinholeIntrinsics(1.6 * focal, intrinsics.center)
    first = initial_poses(observed, prior.mean, start)
    found = bundle_adjust(observed, prior, BundleEstimate(start, prior.mean, first, 0.0))
    assert found.intrinsics.focal == pytest.approx(focal, rel=0.05)
    turned = Rotation.from_matrix(found.poses.rotations.transpose(0, 2, 1) @ true.rotations)
    apart = turned * turned.mean().inv()
    assert np.degrees(apart.magnitude()).max() < 1.0
    assert 0 < found.log_focal_std < bundle_adjustment.PRIOR_LOG_DISTANCE_STD


def test_without_parallax_the_prior_decides(stand_in: StandIn) -> None:
    """A head that never rotates does not constrain the focal length; the prior's stays."""
    face, _ = stand_in
    prior = ShapePrior.from_canonical(face.vertices)
    facing = np.tile(Rotation.from_euler("x", 180, degrees=True).as_matrix(), (5, 1, 1))
    poses = RigidPoses(facing, np.tile([0.0, 0.0, 1.0], (5, 1)))
    intrinsics = PinholeIntrinsics(1000.0, (256.0, 256.0))
    observed = LandmarkObservations(
        project_to_pixels(poses.to_camera(prior.mean[None]), intrinsics), np.full((5, 468), 1 / 30.0**2)
    )
    start = BundleEstimate(
        PinholeIntrinsics(1150.0, intrinsics.center), prior.mean, initial_poses(observed, prior.mean, intrinsics), 0.0
    )
    found = bundle_adjust(observed, prior, start)
    assert found.intrinsics.focal == pytest.approx(1150.0, rel=0.1)
    held = bundle_adjust(observed, prior, start, hold_focal=True)
    assert held.intrinsics.focal == 1150.0 and held.log_focal_std == 0.0


def test_prior_focal_puts_the_face_at_the_typical_distance() -> None:
    poses = RigidPoses(np.tile(np.eye(3), (3, 1, 1)), np.array([[0, 0, 2.0], [0, 0, 2.2], [0, 0, 2.4]]))
    assert prior_focal(poses, PinholeIntrinsics(2200.0, (0.0, 0.0))) == pytest.approx(
        1000.0 * bundle_adjustment.PRIOR_DISTANCE
    )
