"""Skinning of triangles against skinning of the mesh itself."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix, quaternion_to_matrix, rigid
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.head.triangle_skinning import FaceSkinning, blend_rotations


@pytest.fixture
def head(toy_head: HeadModel) -> HeadModel:
    """The egg in float64 with a shoulder that hangs on the root and pose correctives, weights alike within a face."""
    egg = toy_head.to("cpu", torch.float64)
    weights = torch.zeros_like(egg.skinning_weights)
    weights[:, 0], weights[:, 1], weights[:, 2] = 0.2, 0.5, 0.3
    generator = torch.Generator().manual_seed(0)
    correctives = 1e-3 * torch.randn(len(egg.template), 3, 36, generator=generator, dtype=torch.float64)
    return dataclasses.replace(egg, skinning_weights=weights, pose_basis=correctives)


def posed(head: HeadModel) -> Drive:
    """A drive with every joint turned a little and a translation."""
    joints = torch.linspace(-0.3, 0.3, 15, dtype=torch.float64).view(5, 3)
    return dataclasses.replace(
        head.neutral_drive(), joint_rotations=joints, translation=torch.tensor([0.01, -0.02, 0.03]).double()
    )


def test_centroids_move_as_those_of_the_skinned_mesh(head: HeadModel) -> None:
    transforms = FaceSkinning.of(head).transforms(head, posed(head))
    neutral = triangle_frames(head.template, head.faces).centers
    wanted = triangle_frames(head.vertices(posed(head)), head.faces).centers
    got = (transforms.linear @ neutral[:, :, None]).squeeze(-1) + transforms.offset
    assert torch.allclose(got, wanted, atol=1e-9)


def test_faces_of_one_joint_turn_with_it(head: HeadModel) -> None:
    skin, drive = FaceSkinning.of(head).with_rigid_faces([1, 2]), posed(head)
    transforms = skin.transforms(head, drive)
    turns, shifts = head.joint_transforms(drive)
    for row, joint in ((-2, 1), (-1, 2)):
        assert torch.allclose(transforms.linear[row], turns[joint])
        assert torch.allclose(transforms.offset[row], shifts[joint] + drive.translation)
        assert torch.allclose(quaternion_to_matrix(transforms.quats[row]), turns[joint], atol=1e-9)
    assert len(transforms.linear) == len(head.faces) + 2


def test_held_torso_is_that_of_the_mesh(head: HeadModel) -> None:
    drive = head.neutral_drive()
    turned = rigid(axis_angle_to_matrix(torch.tensor([0.1, 0.4, 0.0]).double()), torch.tensor([0.0, 0.1, 0.9]).double())
    drive = dataclasses.replace(drive, head_to_camera=turned)
    poses = HeadPoses.of(head, [head.neutral_drive()])
    wanted = triangle_frames(poses.hold_torso(head.template, drive, head), head.faces).centers
    skin = FaceSkinning.of(head)
    transforms = skin.hold_torso(skin.transforms(head, drive), torch.linalg.inv(turned) @ poses.reference, 0)
    neutral = triangle_frames(head.template, head.faces).centers
    got = (transforms.linear @ neutral[:, :, None]).squeeze(-1) + transforms.offset
    assert torch.allclose(got, wanted, atol=1e-9)


def test_blended_rotations_lie_between() -> None:
    """Halves of two turns about one axis: half the angle (scipy); all of one: that one."""
    turns = torch.from_numpy(Rotation.from_rotvec([[0, 0.2, 0], [0, 1.0, 0]]).as_matrix())
    quats = blend_rotations(torch.tensor([[0.5, 0.5], [0.0, 1.0]]).double(), turns)
    wanted = torch.from_numpy(Rotation.from_rotvec([[0, 0.6, 0], [0, 1.0, 0]]).as_matrix())
    assert torch.allclose(quaternion_to_matrix(quats), wanted, atol=1e-9)
