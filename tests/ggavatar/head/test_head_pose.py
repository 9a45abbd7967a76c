"""The held torso and the bounded pose condition, against what a camera would see."""

from __future__ import annotations

import dataclasses
import math

import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Drive
from ggavatar.geometry.transforms import rigid
from ggavatar.head.head_pose import POSE_FEATURES, HeadPoses
from ggavatar.head.model import HeadModel


def pose(x: float, y: float, z: float, shift: float = 0.0) -> torch.Tensor:
    turn = torch.from_numpy(Rotation.from_rotvec([x, y, z]).as_matrix()).float()
    return rigid(torch.diag(torch.tensor([1.0, -1, -1])) @ turn, torch.tensor([shift, 0.0, 1.0]))


def drives(head: HeadModel) -> list[Drive]:
    turns = [(0.0, 0.4, 0.0, 0.02), (0.0, -0.4, 0.0, -0.02), (0.2, 0.0, 0.1, 0.0), (-0.2, 0.0, -0.1, 0.0)]
    return [dataclasses.replace(head.neutral_drive(), head_to_camera=pose(*turn)) for turn in turns]


def with_torso(head: HeadModel) -> HeadModel:
    """The egg with its lower rows hung on the root."""
    weights = torch.zeros_like(head.skinning_weights)
    low = head.template[:, 1] < -0.05
    weights[low, 0], weights[~low, 1] = 1.0, 1.0
    return dataclasses.replace(head, skinning_weights=weights)


def test_reference_is_a_rotation_between_the_poses(toy_head: HeadModel) -> None:
    reference = HeadPoses.of(toy_head, drives(toy_head)).reference
    assert torch.allclose(reference[:3, :3] @ reference[:3, :3].T, torch.eye(3), atol=1e-5)
    assert torch.allclose(torch.linalg.det(reference[:3, :3]), torch.tensor(1.0))
    assert torch.allclose(reference, pose(0.0, 0.0, 0.0), atol=0.02)


def test_torso_stands_still_before_the_camera_and_the_head_in_head_space(toy_head: HeadModel) -> None:
    head = with_torso(toy_head)
    poses, torso = HeadPoses.of(head, drives(head)), head.skinning_weights[:, 0] == 1
    seen = []
    for drive in drives(head):
        held = poses.hold_torso(head.template, drive, head)
        assert torch.equal(held[~torso], head.template[~torso])
        seen.append(held[torso] @ drive.head_to_camera[:3, :3].T + drive.head_to_camera[:3, 3])
    assert all(torch.allclose(view, seen[0], atol=1e-5) for view in seen)
    at_rest = dataclasses.replace(head.neutral_drive(), head_to_camera=poses.reference)
    assert torch.allclose(poses.hold_torso(head.template, at_rest, head), head.template, atol=1e-6)


def test_a_torso_that_was_followed_is_where_it_was_seen(toy_head: HeadModel) -> None:
    head = with_torso(toy_head)
    poses, torso = HeadPoses.of(head, drives(head)), head.skinning_weights[:, 0] == 1
    seen_torso = pose(0.05, -0.1, 0.02, 0.03)
    for drive in drives(head):
        held = poses.hold_torso(head.template, dataclasses.replace(drive, torso_to_camera=seen_torso), head)
        assert torch.equal(held[~torso], head.template[~torso])
        seen = held[torso] @ drive.head_to_camera[:3, :3].T + drive.head_to_camera[:3, 3]
        wanted = head.template[torso] @ seen_torso[:3, :3].T + seen_torso[:3, 3]
        assert torch.allclose(seen, wanted, atol=1e-5)


def test_trackers_that_turn_the_neck_are_left_alone(toy_head: HeadModel) -> None:
    head = with_torso(toy_head)
    turned = [dataclasses.replace(drive, joint_rotations=torch.full((5, 3), 0.1)) for drive in drives(head)]
    poses = HeadPoses.of(head, turned)
    assert not poses.in_camera and torch.equal(poses.hold_torso(head.template, turned[0], head), head.template)


def test_condition_stays_within_the_training_range(toy_head: HeadModel) -> None:
    known = drives(toy_head)
    poses = HeadPoses.of(toy_head, known)
    features = torch.stack([poses.condition(drive) for drive in known])
    assert features.shape == (4, POSE_FEATURES)
    moving = poses.high - poses.low > 1e-3
    assert int(moving.sum()) >= 6
    assert torch.allclose(features.amax(0)[moving], torch.tensor(1.0), atol=1e-5)
    assert torch.allclose(features.amin(0)[moving], torch.tensor(-1.0), atol=1e-5)
    far = dataclasses.replace(known[0], head_to_camera=pose(0.0, 1.5, 0.0, 3.0))
    assert (poses.condition(far).abs() <= 1).all()


def test_condition_is_the_place_in_the_training_range(toy_head: HeadModel) -> None:
    """In closed form, for heads that turned by up to ±0.4 rad and moved by up to ±2 cm in training.

    About the mean pose F, a turn R shows as F R Fᵀ, whose first two rows are cos, 0, −sin, 0, 1, 0.
    """
    known = [dataclasses.replace(toy_head.neutral_drive(), head_to_camera=pose(0, a, 0, a / 20)) for a in (0.4, -0.4)]
    poses = HeadPoses.of(toy_head, known)

    def condition(angle: float, shift: float) -> torch.Tensor:
        return poses.condition(dataclasses.replace(known[0], head_to_camera=pose(0, angle, 0, shift)))

    half_way = torch.zeros(9)
    half_way[0] = 1.0  # the cosine was cos 0.4 in all of training, so any other is beyond its range
    half_way[2], half_way[6] = -math.sin(0.2) / math.sin(0.4), 0.01 / 0.02
    assert torch.allclose(condition(0.2, 0.01), half_way, atol=1e-3)
    ends = torch.zeros(9)
    ends[2], ends[6] = -1.0, 1.0
    assert torch.allclose(condition(0.4, 0.02), ends, atol=1e-3)
    assert condition(1.5, 3.0)[[2, 6]].tolist() == [-1.0, 1.0]


def test_no_drives_mean_a_head_at_rest(toy_head: HeadModel) -> None:
    poses = HeadPoses.of(toy_head, [])
    assert torch.equal(poses.condition(toy_head.neutral_drive()), torch.zeros(9))
