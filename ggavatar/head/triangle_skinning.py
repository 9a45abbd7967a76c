"""Linear blend skinning of triangles: every face moves with the mean skinning weights of its corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix, matrix_to_quaternion, quaternion_multiply
from ggavatar.head.model import HeadModel


class FaceTransforms(NamedTuple):
    """Transforms of all faces: x ↦ linear x + offset (m), and their rotations as unit quaternions wxyz."""

    linear: Float[Tensor, "F 3 3"]
    offset: Float[Tensor, "F 3"]
    quats: Float[Tensor, "F 4"]


@dataclass(frozen=True)
class FaceSkinning:
    """Skinning weights and pose correctives of each face.

    Attributes:
        weights: Skinning weights of the joints; rows sum to 1.
        pose_basis: Displacement per entry of vec(R_j − I) before skinning, m, as in `HeadModel`.
    """

    weights: Float[Tensor, "F J"]
    pose_basis: Float[Tensor, "F 3 P"]

    @staticmethod
    def of(head: HeadModel) -> FaceSkinning:
        """Means over the three corners of every face."""
        return FaceSkinning(head.skinning_weights[head.faces].mean(1), head.pose_basis[head.faces].mean(1))

    def with_rigid_faces(self, joints: list[int]) -> FaceSkinning:
        """The same with one more face for each given joint, bound to it rigidly."""
        extra = torch.zeros(len(joints), self.weights.shape[1]).to(self.weights)
        extra[range(len(joints)), joints] = 1.0
        still = self.pose_basis.new_zeros(len(joints), *self.pose_basis.shape[1:])
        return FaceSkinning(torch.cat((self.weights, extra)), torch.cat((self.pose_basis, still)))

    def transforms(self, head: HeadModel, drive: Drive) -> FaceTransforms:
        """Transforms of every face: pose correctives, then the blended joints, then the translation of the drive.

        The rotation is the normalized blend of the joints' quaternions.
        """
        turns, shifts = head.joint_transforms(drive)
        linear = (self.weights @ turns.flatten(1)).unflatten(1, (3, 3))
        offset = self.weights @ shifts + drive.translation
        if self.pose_basis.shape[2]:
            rotations = axis_angle_to_matrix(drive.joint_rotations)[1:]
            feature = (rotations - torch.eye(3).to(rotations)).flatten()
            offset = offset + (linear @ (self.pose_basis @ feature)[:, :, None]).squeeze(-1)
        return FaceTransforms(linear, offset, blend_rotations(self.weights, turns))

    def hold_torso(self, transforms: FaceTransforms, torso: Float[Tensor, "4 4"], root: int) -> FaceTransforms:
        """The transforms with faces skinned to the root joint moved rigidly by `torso`; see `HeadPoses.hold_torso`."""
        share = self.weights[:, root, None]
        linear = torch.lerp(transforms.linear, torso[:3, :3] @ transforms.linear, share[:, :, None])
        offset = torch.lerp(transforms.offset, transforms.offset @ torso[:3, :3].T + torso[:3, 3], share)
        identity = torch.eye(3).to(torso)
        turn = blend_rotations(torch.cat((1 - share, share), dim=1), torch.stack((identity, torso[:3, :3])))
        return FaceTransforms(linear, offset, quaternion_multiply(turn, transforms.quats))


def blend_rotations(weights: Float[Tensor, "F J"], rotations: Float[Tensor, "J 3 3"]) -> Float[Tensor, "F 4"]:
    """Unit quaternions that blend rotations by weights; the rotations must differ by less than half a turn."""
    quats = matrix_to_quaternion(rotations)
    return normalize(weights @ torch.where(quats[:, :1] < 0, -quats, quats), dim=-1)
