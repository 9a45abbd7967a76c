"""Uses of the head pose: a torso that does not turn with the head, and a bounded condition vector for networks.

Trackers that put the head pose into the camera leave the head still in the world; whatever does not move with the head
(shoulders, a collar, long hair) then moves in head space. Both uses read `Drive.head_to_camera`.

The mean rotation is the SVD projection in torch, not scipy's `Rotation.mean`: trained avatars depend on its last bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.geometry.transforms import invert_rigid, matrix_to_rotation_6d, rigid
from ggavatar.head.model import HeadModel

POSE_FEATURES = 9


@dataclass(frozen=True)
class HeadPoses:
    """Mean and range of the head pose over the training frames.

    Attributes:
        reference: Mean pose, head to camera; also the assumed pose of a torso at rest.
        low: Minimum of each raw feature (`condition`) in training.
        high: Maximum of each raw feature in training.
        in_camera: Whether the tracker put the head pose into the camera: root and neck are unrotated in all frames.
    """

    reference: Float[Tensor, "4 4"]
    low: Float[Tensor, "9"]
    high: Float[Tensor, "9"]
    in_camera: bool

    @staticmethod
    def of(head: HeadModel, drives: Sequence[Drive]) -> HeadPoses:
        """Summarize the drives of the training frames; without drives, use the neutral one."""
        drives = drives or [head.neutral_drive()]
        poses = torch.stack([drive.head_to_camera for drive in drives])
        left, _, right = torch.linalg.svd(poses[:, :3, :3].mean(0))
        straight = (
            left @ torch.diag(torch.tensor([1.0, 1.0, torch.linalg.det(left @ right).sign().item()]).to(left)) @ right
        )
        reference = rigid(straight, poses[:, :3, 3].mean(0))
        features = _relative(poses, reference)
        carried = [head.joint_index(name) for name in ("root", "neck") if name in head.joint_names]
        in_camera = all(not bool(drive.joint_rotations[carried].any()) for drive in drives)
        return HeadPoses(reference, features.amin(0), features.amax(0), in_camera)

    def condition(self, drive: Drive) -> Float[Tensor, "9"]:
        """Head rotation (6D) and translation relative to the reference, each scaled to [−1, 1] by its training range.

        Poses outside the training range are clamped to it, so that a network sees no values it was not trained on.
        """
        raw = _relative(drive.head_to_camera[None], self.reference)[0]
        middle, half = (self.high + self.low) / 2, (self.high - self.low) / 2
        return ((raw - middle) / half.clamp_min(1e-4)).clamp(-1, 1)

    def torso(self, drive: Drive) -> Float[Tensor, "4 4"]:
        """Rigid transform of the torso in head space, from its tracked pose or else the reference pose."""
        seen = self.reference if drive.torso_to_camera is None else drive.torso_to_camera
        return invert_rigid(drive.head_to_camera) @ seen

    def hold_torso(self, vertices: Float[Tensor, "V 3"], drive: Drive, head: HeadModel) -> Float[Tensor, "V 3"]:
        """Blend torso vertices to the torso pose, by their skinning weight of the root joint; all in head space, m.

        This is linear blend skinning about the neck with the head as the fixed end. Where the tracker itself rotates
        root or neck, skinning has already done this and the vertices are returned unchanged.
        """
        if not self.in_camera:
            return vertices
        torso = self.torso(drive)
        moved = vertices @ torso[:3, :3].T + torso[:3, 3]
        return torch.lerp(vertices, moved, head.skinning_weights[:, head.joint_index("root"), None])


def _relative(poses: Float[Tensor, "T 4 4"], reference: Float[Tensor, "4 4"]) -> Float[Tensor, "T 9"]:
    """Rotation from the reference as 6D and translation from it, m."""
    turned = poses[:, :3, :3] @ reference[:3, :3].T
    return torch.cat((matrix_to_rotation_6d(turned), poses[:, :3, 3] - reference[:3, 3]), dim=1)
