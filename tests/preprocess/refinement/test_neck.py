"""The torso's pose of a tracked head against the head model's own vertices, and there and back."""

from __future__ import annotations

import numpy as np
import pytest

from preprocess.refinement.neck import Neck
from preprocess.tracking.geometry.projection import posed_vertices


def test_only_heads_of_our_tracker_have_one(ball, tracked_head):
    assert Neck.of(ball) is None and Neck.of(tracked_head) is not None


def test_pose_is_that_of_the_vertices_bound_to_the_torso_alone(tracked_head, tracked):
    """Vertices that follow the torso's joint alone, as the head model poses them, are the rigidly moved template's."""
    neck = Neck.of(tracked_head)
    still = tracked_head.expression_basis[:, :, :-1].abs().amax((1, 2)) < 1e-9
    rows = ((tracked_head.skinning_weights[:, neck.lower] > 1 - 1e-6) & still).nonzero().flatten().numpy()
    assert len(rows) > 50
    poses = neck.torso_in_head(tracked.expression, tracked.joint_rotations)
    template = tracked_head.template.double().numpy()[rows]
    for row, pose in enumerate(poses):
        expected = posed_vertices(tracked_head, tracked, row)[rows]
        np.testing.assert_allclose(template @ pose[:3, :3].T + pose[:3, 3], expected, atol=2e-5)


def test_there_and_back(tracked_head, tracked):
    neck = Neck.of(tracked_head)
    torso = tracked.world_to_camera @ neck.torso_in_head(tracked.expression, tracked.joint_rotations)
    parts = neck.with_torso(tracked.expression, tracked.joint_rotations, tracked.world_to_camera, torso)
    again = tracked.world_to_camera @ neck.torso_in_head(*parts)
    np.testing.assert_allclose(again, torso, atol=1e-9)
    assert parts[0][:, :-1] == pytest.approx(tracked.expression[:, :-1])
