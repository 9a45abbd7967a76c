"""From drives to what canonical points need: blendshape coefficients, and transforms of joints and a static joint.

Camera and torso are static in PointAvatar while the head turns. Trackers that put the head pose into the camera keep
the head static instead; the static joint then is the torso in front of the camera.
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
from ggavatar.points.skinning import BoneTransforms


class PosedSkeleton(NamedTuple):
    """Blendshape coefficients relative to the canonical pose, the camera's axes, and all canonical and posed bones."""

    correctives: Float[Tensor, " B"]
    head_to_camera: Float[Tensor, "3 3"]
    canonical_rotations: Float[Tensor, "J 3 3"]
    canonical_offsets: Float[Tensor, "J 3"]
    rotations: Float[Tensor, "J 3 3"]
    offsets: Float[Tensor, "J 3"]

    @property
    def canonical(self) -> BoneTransforms:
        """The bones in the canonical pose."""
        return BoneTransforms(self.canonical_rotations, self.canonical_offsets)

    @property
    def posed(self) -> BoneTransforms:
        """The bones posed by the drive."""
        return BoneTransforms(self.rotations, self.offsets)


@dataclass(frozen=True)
class SkeletonDriver:
    """Converts drives to posed skeletons.

    Attributes:
        head: The head model.
        canonical: The drive of the canonical pose.
        poses: Head poses of the training frames.
        unit: Units of length of the points per meter.
        root_is_still: Whether the head's root joint moves with the torso.
    """

    head: HeadModel
    canonical: Drive
    poses: HeadPoses
    unit: float
    root_is_still: bool

    def posed_skeleton(self, drive: Drive) -> PosedSkeleton:
        """The skeleton posed by a drive, without the drive's translation."""
        correctives = shape_coefficients(drive) - shape_coefficients(self.canonical)
        rotations, offsets = self.head.joint_transforms(self.canonical)
        still, rest = torch.eye(3, dtype=rotations.dtype, device=rotations.device), rotations.new_zeros(3)
        canonical = self._bones((still, rest), (rotations, offsets))
        rotations, offsets = self.head.joint_transforms(drive)
        if self.poses.in_camera:
            torso = self.poses.torso(drive)
            still, rest = torso[:3, :3], torso[:3, 3]
        shift = rest - drive.translation
        if self.poses.in_camera and self.root_is_still:
            root = torch.arange(len(offsets), device=offsets.device) == self.head.joint_index("root")
            rotations = torch.where(root[:, None, None], still @ rotations, rotations)
            offsets = torch.where(root[:, None], offsets @ still.T + shift, offsets)
        return PosedSkeleton(
            correctives, drive.head_to_camera[:3, :3], *canonical, *self._bones((still, shift), (rotations, offsets))
        )

    def _bones(self, still: tuple[Tensor, Tensor], joints: tuple[Tensor, Tensor]) -> BoneTransforms:
        """The static joint, then the head's joints, in the unit of the points."""
        rotations = torch.cat((still[0][None], joints[0]))
        return BoneTransforms(rotations, self.unit * torch.cat((still[1][None], joints[1])))


def canonical_drive(head: HeadModel, drives: Sequence[Drive], jaw: float) -> Drive:
    """The drive of the canonical pose: mean expression and eyelids of some drives, the jaw open by `jaw` rad."""
    still = head.neutral_drive()
    joints = still.joint_rotations.clone()
    if "jaw" in head.joint_names:
        joints[head.joint_index("jaw"), 0] = jaw
    expression = torch.stack([drive.expression for drive in drives]).mean(0)
    lids = torch.stack([drive.eyelids for drive in drives]).mean(0)
    return dataclasses.replace(still, joint_rotations=joints, expression=expression, eyelids=lids)


def expression_coefficients(drive: Drive) -> Float[Tensor, " E"]:
    """Coefficients of expressions, then of eyelids; all of them are blendshapes."""
    return torch.cat((drive.expression, drive.eyelids))


def shape_coefficients(drive: Drive) -> Float[Tensor, " B"]:
    """vec(R − I) of all joints but the root, then the coefficients of expressions and eyelids."""
    rotations = axis_angle_to_matrix(drive.joint_rotations[1:])
    feature = (rotations - torch.eye(3, dtype=rotations.dtype, device=rotations.device)).flatten()
    return torch.cat((feature, expression_coefficients(drive)))
