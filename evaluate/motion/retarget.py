"""Make a foreign performance fit an avatar's head, and turn it into drives and cameras."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from evaluate.motion.driving_sequence import DrivingSequence
from ggavatar.core import Camera, Drive
from ggavatar.data.frames import head_pose
from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel


def retarget(driver: DrivingSequence, target: DrivingSequence, force: bool = False) -> DrivingSequence:
    """The driver's motion with the target's number of coefficients and order of joints; joints it lacks stay at rest.

    Args:
        driver: The performance.
        target: DrivingSequence of the capture that the avatar was trained on.
        force: Accept another version or number of coefficients within one family of bases: missing ones are zero, those
            too many are dropped.

    Raises:
        InputError: The expression bases differ, and are not of one family or `force` is not set.
    """
    count = target.expression.shape[1]
    same = driver.head_version == target.head_version and driver.expression.shape[1] == count
    if not same and basis_family(driver.head_version) != basis_family(target.head_version):
        raise InputError(
            f"expected a performance of the head {target.head_version!r}, found {driver.head_version!r}, whose numbers "
            "mean different things; prepare both videos in the same way (both without --tracking, or both with one "
            "tracker and one --head-model) and train on one of them"
        )
    if not same and not force:
        raise InputError(
            f"expected {count} coefficients of {target.head_version!r}, found {driver.expression.shape[1]} of "
            f"{driver.head_version!r}; track both with one head model, or pass --force-basis to fill up with zeros and "
            "drop what is too many"
        )
    expression = np.zeros((len(driver.frames), count))
    shared = min(count, driver.expression.shape[1])
    expression[:, :shared] = driver.expression[:, :shared]
    joints = np.zeros((len(driver.frames), len(target.joint_names), 3))
    for index, name in enumerate(target.joint_names):
        if name in driver.joint_names:
            joints[:, index] = driver.joint_rotations[:, driver.joint_names.index(name)]
    return dataclasses.replace(
        driver,
        expression=expression,
        joint_rotations=joints,
        joint_names=target.joint_names,
        head_version=target.head_version,
    )


def basis_family(version: str) -> str:
    """The part of a version tag that names its basis: without year, number or size at the end (flame2020 → flame)."""
    return re.sub(r"[-_.]?v?\d+([-_.]\d+)*$", "", version.lower())


def drives_and_cameras(motion: DrivingSequence, head: HeadModel) -> Iterator[tuple[int, Drive, Camera]]:
    """Frame number, drive and camera of every row, on the device of the head; the drives name no training frame.

    Raises:
        InputError: The motion has no cameras.
    """
    cameras = motion.cameras
    if cameras is None:
        raise InputError("expected a motion with cameras to draw, found one without; use --transfer relative")
    for row, frame in enumerate(motion.frames):
        joints, translation = _tensor(motion.joint_rotations[row], head), _tensor(motion.translation[row], head)
        view = _tensor(cameras.world_to_camera[row], head)
        drive = Drive(
            expression=_tensor(motion.expression[row], head),
            joint_rotations=joints,
            eyelids=_tensor(motion.eyelids[row], head),
            translation=translation,
            head_to_camera=view @ head_pose(head, joints, translation),
        )
        yield frame, drive, Camera(_tensor(cameras.intrinsics[row], head), view, *cameras.size)


def _tensor(values: np.ndarray, head: HeadModel) -> Tensor:
    return torch.as_tensor(values).to(head.template)
