"""Two heads: a small ball with a torso, and one such as our tracker makes; and trackings of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record


@pytest.fixture(scope="session")
def ball() -> HeadModel:
    """The ball, with landmarks on its nose side."""
    head = ball_head()
    front = torch.nonzero(head.template[head.faces].mean(1)[:, 2] > 0.03).flatten()[::3]
    weights = torch.full((len(front), 3), 1 / 3)
    return dataclasses.replace(head, regions={"landmarks": head.faces[front].flatten()}, landmark_weights=weights)


@pytest.fixture(scope="session")
def ball_tracking() -> Tracking:
    """24 frames of it."""
    return as_tracking(moving_record())


@pytest.fixture(scope="session")
def tracked_head() -> HeadModel:
    """A head of our tracker's version, of the average face."""
    from ggavatar.landmarks.average_face import average_face
    from preprocess.tracking.head.generic_head import generic_head
    from preprocess.tracking.head.personal_head import assemble_head, fit_shape, lid_axes

    generic = generic_head(average_face())
    neutral = generic.landmarks @ generic.vertices
    shape = fit_shape(generic, neutral)
    named = (generic.landmarks @ generic.axes.reshape(len(generic.vertices), -1)).reshape(468, 3, -1)
    return assemble_head(generic, shape, named, np.zeros((468, 3, 0)), lid_axes(neutral, shape))


@pytest.fixture(scope="session")
def tracked(tracked_head: HeadModel) -> Tracking:
    """Eight frames of it in front of a camera, with a moving neck."""
    count, generator = 8, np.random.default_rng(3)
    expression = generator.normal(0, 0.2, (count, tracked_head.expression_basis.shape[2]))
    expression[:, -1] = generator.uniform(-1, 1, count)
    joints = generator.normal(0, 0.08, (count, len(tracked_head.joint_names), 3))
    joints[:, :2] = 0
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    poses[:, :3, 3] = [0.0, 0.0, 0.8]
    return Tracking(
        intrinsics=np.tile([[400.0, 0, 64], [0, 400.0, 64], [0, 0, 1]], (count, 1, 1)),
        world_to_camera=poses,
        expression=expression,
        joint_rotations=joints,
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
    )
