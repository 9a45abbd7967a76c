"""Drives for which an avatar is exported: neutral, or those of frames of its capture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.data.frames import head_pose
from ggavatar.geometry.transforms import invert_rigid
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.training.run_folder import Run


class NamedDrive(NamedTuple):
    """A drive and the stem of the file that the avatar is written to."""

    name: str
    drive: Drive


def neutral_drive(run: Run, head: HeadModel) -> NamedDrive:
    """No expression and all joints at rest, with the mean pose of the head in the training frames."""
    poses = HeadPoses.of(head, [run.reader.drive(number) for number in run.split.train])
    return NamedDrive("neutral", dataclasses.replace(head.neutral_drive(), head_to_camera=poses.reference))


def frame_drives(run: Run, frames: tuple[int, ...]) -> list[NamedDrive]:
    """The drives of source frames; raises an `InputError` if the capture does not have one of them."""
    return [NamedDrive(f"frame-{number:06d}", run.reader.drive(number)) for number in frames]


def mean_training_view(head: HeadModel, poses: HeadPoses, drives: Sequence[Drive]) -> Float[Tensor, "4 4"]:
    """World-to-camera transform that shows a head at rest in a pose that a method was trained on.

    Args:
        head: The head model.
        poses: Of the training frames.
        drives: Those of the training frames.
    """
    if poses.in_camera or not drives:
        return poses.reference
    return drives[0].head_to_camera @ invert_rigid(head_pose(head, drives[0].joint_rotations, drives[0].translation))
