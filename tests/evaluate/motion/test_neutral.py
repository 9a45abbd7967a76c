"""Rest of face and head: gaze and torso do not decide. Reference: scipy's rotations."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from evaluate.motion.neutral import TOWARDS_CAMERA, facing_row, neutral_row, turn_from_camera
from tests.support.performances import motion


def turned(seed: int, angles: np.ndarray):
    """A sequence whose heads are turned from the camera by these angles, about random axes; joints at rest."""
    sequence = motion(seed, len(angles))
    axes = np.random.default_rng(seed).normal(size=(len(angles), 3))
    axes *= angles[:, None] / np.linalg.norm(axes, axis=1, keepdims=True)
    assert sequence.cameras
    views = sequence.cameras.world_to_camera.copy()
    views[:, :3, :3] = TOWARDS_CAMERA @ Rotation.from_rotvec(axes).as_matrix()
    cameras = dataclasses.replace(sequence.cameras, world_to_camera=views)
    return dataclasses.replace(sequence, cameras=cameras, joint_rotations=np.zeros((len(angles), 5, 3)))


def test_angles_are_those_between_head_and_camera() -> None:
    angles = np.linspace(0.05, 1.2, 20)
    np.testing.assert_allclose(turn_from_camera(turned(1, angles)), angles, atol=1e-9)
    sequence = turned(1, angles)
    joints = sequence.joint_rotations.copy()
    joints[:, 1] = [0.0, 0.3, 0.0]  # the neck turns the head as well
    bent = dataclasses.replace(sequence, joint_rotations=joints)
    assert sequence.cameras
    heads = sequence.cameras.world_to_camera[:, :3, :3] @ Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()
    expected = Rotation.from_matrix(TOWARDS_CAMERA @ heads).magnitude()
    np.testing.assert_allclose(turn_from_camera(bent), expected, atol=1e-9)


def test_the_head_faces_the_camera() -> None:
    angles = np.full(15, 0.5)
    angles[6] = 0.02
    assert facing_row(turned(2, angles)) == 6


def test_gaze_does_not_decide_what_is_neutral() -> None:
    """The quiet face looks aside; frames that look ahead grimace."""
    sequence = turned(3, np.full(20, 0.1))
    expression, joints = sequence.expression.copy(), sequence.joint_rotations.copy()
    expression[11] = 0.01
    lids = np.full((20, 2), 0.3)
    lids[11] = 0.0
    joints[11, 3:] = [0.0, 0.6, 0.0]
    quiet = dataclasses.replace(sequence, expression=expression, joint_rotations=joints, eyelids=lids)
    assert neutral_row(quiet) == 11


def test_a_quiet_face_that_is_turned_away_is_not_taken() -> None:
    angles = np.full(21, 0.1)
    angles[4] = 0.9
    sequence = turned(4, angles)
    expression = sequence.expression.copy()
    expression[4], expression[15] = 0.0, 0.02
    lids = np.full((21, 2), 0.3)
    lids[[4, 15]] = 0.0
    assert neutral_row(dataclasses.replace(sequence, expression=expression, eyelids=lids)) == 15
