"""What sliders do to a drive: single numbers of it, and the turn of the head."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from evaluate.motion.orbit import head_center
from evaluate.viewer.orbit import Bounds
from ggavatar.core import Camera, Drive
from ggavatar.formats.drives import mean_training_view
from ggavatar.formats.web.controls import Slider, sliders, view_range
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel

LARGEST_TILT = 0.35
"""Range of the slider that tilts the head, rad; as on the web page."""


@dataclass(frozen=True)
class Turn:
    """A turn of the head about its neck, rad; positive angles turn to the subject's left, nod, and tilt to the left."""

    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    def matrix(self, like: Tensor) -> Float[Tensor, "3 3"]:
        """The rotation Ry(yaw) Rx(pitch) Rz(roll)."""
        about = ([0.0, self.yaw, 0.0], [self.pitch, 0.0, 0.0], [0.0, 0.0, self.roll])
        first, second, third = (axis_angle_to_matrix(like.new_tensor(one)) for one in about)
        return first @ second @ third


@dataclass(frozen=True)
class Controls:
    """What a head and a training offer to be moved, by the names and limits of the web page.

    Attributes:
        head: The head.
        poses: Head poses in training.
        sliders: For single numbers of a drive.
        bounds: How far the view may turn without showing what training never saw.
        rest: No expression, all joints at rest, in a pose that training saw.
        camera: Sees the drive at rest.
        pivot: The point about which the view turns, in the space of that camera, m.
    """

    head: HeadModel
    poses: HeadPoses
    sliders: tuple[Slider, ...]
    bounds: Bounds
    rest: Drive
    camera: Camera
    pivot: Float[np.ndarray, "3"]

    @staticmethod
    def of(head: HeadModel, drives: list[Drive], camera: Camera) -> Controls:
        """The controls of a head, from the drives of the training frames and a camera of the capture."""
        neutral = head.neutral_drive()
        drives = drives or [neutral]
        poses = HeadPoses.of(head, drives)
        view = mean_training_view(head, poses, drives)
        seen = view_range(poses, drives)
        center = view[:3, :3] @ head_center(head, neutral) + view[:3, 3]
        return Controls(
            head=head,
            poses=poses,
            sliders=tuple(sliders(head, drives)),
            bounds=Bounds(_pair(seen["yaw"]), _pair(seen["pitch"])),
            rest=dataclasses.replace(neutral, head_to_camera=view),
            camera=dataclasses.replace(camera, world_to_camera=view),
            pivot=center.detach().cpu().numpy().astype(np.float64),
        )

    def turns(self) -> dict[str, tuple[float, float]]:
        """Least and most of every angle of `Turn`, rad: as if the views of training were seen by a camera at rest."""
        low, high = self.bounds.yaw
        return {"yaw": (-high, -low), "pitch": self.bounds.pitch, "roll": (-LARGEST_TILT, LARGEST_TILT)}

    def turned(self, drive: Drive, camera: Camera, turn: Turn) -> tuple[Drive, Camera]:
        """Drive and camera with the head turned about its neck; a torso that has a pose or a joint of its own stays."""
        if turn == Turn():
            return drive, camera
        rotation = turn.matrix(drive.head_to_camera)
        about = self._about_neck(rotation)
        turned = dataclasses.replace(drive, head_to_camera=drive.head_to_camera @ about)
        if not self.poses.in_camera:
            return self._with_joint(turned, "neck", rotation, after=True), camera
        moved = dataclasses.replace(camera, world_to_camera=camera.world_to_camera @ about)
        return self._with_joint(turned, "cervical", rotation.T, after=False), moved

    def _about_neck(self, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "4 4"]:
        joints = self.head.joint_regressor @ self.head.template
        neck = joints[self.head.joint_index("neck") if "neck" in self.head.joint_names else 0]
        return rigid(rotation, neck - rotation @ neck)

    def _with_joint(self, drive: Drive, name: str, rotation: Float[Tensor, "3 3"], after: bool) -> Drive:
        """The drive with one joint turned on, in its own axes or before them; the same if there is no such joint."""
        if name not in self.head.joint_names:
            return drive
        joint = self.head.joint_index(name)
        own, added = (
            Rotation.from_matrix(one.detach().cpu().double().numpy())
            for one in (axis_angle_to_matrix(drive.joint_rotations[joint]), rotation)
        )
        joints = drive.joint_rotations.clone()
        turned = own * added if after else added * own
        joints[joint] = torch.as_tensor(turned.as_rotvec()).to(joints)
        return dataclasses.replace(drive, joint_rotations=joints)


def _pair(values: list[float]) -> tuple[float, float]:
    low, high = values
    return low, high


def value_of(drive: Drive, slider: Slider) -> float:
    """Where a slider stands for a drive; a slider that moves several numbers shows the first."""
    part, place, factor = slider.targets[0]
    value = float(getattr(drive, part).reshape(-1)[place]) / factor
    return value if math.isfinite(value) else 0.0


def with_value(drive: Drive, slider: Slider, value: float) -> Drive:
    """The drive with the numbers that a slider moves, of no frame of the capture any more."""
    changed: dict[str, Tensor] = {}
    for part, place, factor in slider.targets:
        field = changed.setdefault(part, getattr(drive, part).clone())
        field.view(-1)[place] = value * factor
    return dataclasses.replace(drive, frame=None, **changed)
