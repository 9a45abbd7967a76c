"""The head pose as methods may use it: a torso that does not turn with the head, and a bounded condition for networks.

Trackers that put the head pose into the camera leave the head still; whatever does not move with it (shoulders, a
collar, long hair) then moves in head space. Both uses below read `Drive.head_to_camera`.
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
    """What the training frames say about the head pose.

    Attributes:
        reference: Mean pose, head to camera; a torso at rest is taken to be posed like this.
        low: Smallest value of each raw feature in training.
        high: Largest value of each raw feature in training.
        in_camera: Whether the tracker put the head pose into the camera in all frames, root and neck being unturned.
    """

    reference: Float[Tensor, "4 4"]
    low: Float[Tensor, "9"]
    high: Float[Tensor, "9"]
    in_camera: bool

    @staticmethod
    def of(head: HeadModel, drives: Sequence[Drive]) -> HeadPoses:
        """Summarize the drives of the training frames; without any, the head is at rest in front of the camera."""
        drives = drives or [head.neutral_drive()]
        poses = torch.stack([drive.head_to_camera for drive in drives])
        left, _, right = torch.linalg.svd(poses[:, :3, :3].mean(0))
        straight = (
            left @ torch.diag(torch.tensor([1.0, 1.0, torch.linalg.det(left @ right).sign().item()]).to(left)) @ right
        )
        reference = rigid(straight, poses[:, :3, 3].mean(0))
        features = _relative(poses, reference)
        carried = [head.joint(name) for name in ("root", "neck") if name in head.joint_names]
        in_camera = all(not bool(drive.joint_rotations[carried].any()) for drive in drives)
        return HeadPoses(reference, features.amin(0), features.amax(0), in_camera)

    def condition(self, drive: Drive) -> Float[Tensor, "9"]:
        """Head rotation (6D) and translation against the reference, each scaled by its training range to [−1, 1].

        Poses beyond the training range give its border: a network is never asked about what it has not seen.
        """
        raw = _relative(drive.head_to_camera[None], self.reference)[0]
        middle, half = (self.high + self.low) / 2, (self.high - self.low) / 2
        return ((raw - middle) / half.clamp_min(1e-4)).clamp(-1, 1)

    def torso(self, drive: Drive) -> Float[Tensor, "4 4"]:
        """Rigid motion of the torso in head space: to where it was followed, or to its rest before the camera."""
        seen = self.reference if drive.torso_to_camera is None else drive.torso_to_camera
        return invert_rigid(drive.head_to_camera) @ seen

    def hold_torso(self, vertices: Float[Tensor, "V 3"], drive: Drive, head: HeadModel) -> Float[Tensor, "V 3"]:
        """Vertices in head space, m, with what hangs on the root joint held where the torso is before the camera.

        This is linear blend skinning by the neck with the head as the fixed end. Where the tracker turns root or neck
        itself, skinning has done so already and nothing changes.
        """
        if not self.in_camera:
            return vertices
        torso = self.torso(drive)
        moved = vertices @ torso[:3, :3].T + torso[:3, 3]
        return torch.lerp(vertices, moved, head.skinning_weights[:, head.joint("root"), None])


def _relative(poses: Float[Tensor, "T 4 4"], reference: Float[Tensor, "4 4"]) -> Float[Tensor, "T 9"]:
    """Rotation from the reference as 6D and translation from it, m."""
    turned = poses[:, :3, :3] @ reference[:3, :3].T
    return torch.cat((matrix_to_rotation_6d(turned), poses[:, :3, 3] - reference[:3, 3]), dim=1)
