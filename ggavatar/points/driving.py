"""What a drive says to canonical points: blendshape coefficients, and transforms of the joints and of a still one.

PointAvatar's camera and torso stand still while the head turns. Trackers that put the head pose into the camera keep
the head still instead; its joint that never moves is then the torso held before the camera.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.points.skinning import Bones


class Pose(NamedTuple):
    """Correctives [B], the camera's axes, and rotation and offset of all bones in the canonical and the posed head."""

    correctives: Float[Tensor, " B"]
    head_to_camera: Float[Tensor, "3 3"]
    canonical_rotations: Float[Tensor, "J 3 3"]
    canonical_offsets: Float[Tensor, "J 3"]
    rotations: Float[Tensor, "J 3 3"]
    offsets: Float[Tensor, "J 3"]

    @property
    def canonical(self) -> Bones:
        """Bones of the canonical pose."""
        return Bones(self.canonical_rotations, self.canonical_offsets)

    @property
    def posed(self) -> Bones:
        """Bones of the drive."""
        return Bones(self.rotations, self.offsets)


@dataclass(frozen=True)
class Driver:
    """Turns drives into poses of points.

    Attributes:
        head: Any head.
        canonical: The drive of the canonical pose.
        poses: What the training says about the head pose.
        unit: Units of length of the points per meter.
        root_is_still: Whether the head's root joint goes with the torso.
    """

    head: HeadModel
    canonical: Drive
    poses: HeadPoses
    unit: float
    root_is_still: bool

    def pose(self, drive: Drive) -> Pose:
        """What this drive says to all points; its translation is left to the caller."""
        correctives = shape_coefficients(drive) - shape_coefficients(self.canonical)
        rotations, offsets = self.head.joint_transforms(self.canonical)
        still, rest = torch.eye(3).to(rotations), torch.zeros(3).to(rotations)
        canonical = self._bones((still, rest), (rotations, offsets))
        rotations, offsets = self.head.joint_transforms(drive)
        if self.poses.in_camera:
            torso = self.poses.torso(drive)
            still, rest = torso[:3, :3], torso[:3, 3]
        shift = rest - drive.translation
        if self.poses.in_camera and self.root_is_still:
            root = torch.arange(len(offsets), device=offsets.device) == self.head.joint("root")
            rotations = torch.where(root[:, None, None], still @ rotations, rotations)
            offsets = torch.where(root[:, None], offsets @ still.T + shift, offsets)
        return Pose(
            correctives, drive.head_to_camera[:3, :3], *canonical, *self._bones((still, shift), (rotations, offsets))
        )

    def _bones(self, still: tuple[Tensor, Tensor], joints: tuple[Tensor, Tensor]) -> Bones:
        """The joint that never moves, then the head's, in the unit of the points."""
        rotations = torch.cat((still[0][None], joints[0]))
        return Bones(rotations, self.unit * torch.cat((still[1][None], joints[1])))


def canonical_drive(head: HeadModel, drives: Sequence[Drive], jaw: float) -> Drive:
    """The pose in which points are at home: mean expression and lids of some drives, the jaw open by `jaw` rad."""
    still = head.neutral_drive()
    joints = still.joint_rotations.clone()
    if "jaw" in head.joint_names:
        joints[head.joint("jaw"), 0] = jaw
    expression = torch.stack([drive.expression for drive in drives]).mean(0)
    lids = torch.stack([drive.eyelids for drive in drives]).mean(0)
    return dataclasses.replace(still, joint_rotations=joints, expression=expression, eyelids=lids)


def expression_coefficients(drive: Drive) -> Float[Tensor, " E"]:
    """Expression coefficients, then lids: all of them are blendshapes."""
    return torch.cat((drive.expression, drive.eyelids))


def shape_coefficients(drive: Drive) -> Float[Tensor, " B"]:
    """vec(R − I) of all joints but the root, then expression coefficients and lids."""
    rotations = axis_angle_to_matrix(drive.joint_rotations[1:])
    feature = (rotations - torch.eye(3).to(rotations)).flatten()
    return torch.cat((feature, expression_coefficients(drive)))
