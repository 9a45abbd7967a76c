"""A driving sequence in the expression basis and joint order of an avatar's head, and as drives and cameras."""

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


def match_basis(driver: DrivingSequence, target: DrivingSequence, force: bool = False) -> DrivingSequence:
    """The driving sequence with the target's number of coefficients and joint order; joints it lacks stay at rest.

    Args:
        driver: Sequence to adapt.
        target: Sequence of the capture that the avatar was trained on.
        force: Accept another version or number of coefficients within one family of bases: missing coefficients become
            zero, surplus ones are dropped.

    Raises:
        InputError: The expression bases differ, and they are of different families or `force` is not set.
    """
    count = target.expression.shape[1]
    same = driver.head_version == target.head_version and driver.expression.shape[1] == count
    if not same and basis_family(driver.head_version) != basis_family(target.head_version):
        raise InputError(
            f"expected a driving sequence for the head {target.head_version!r}, found {driver.head_version!r}, whose "
            "coefficients mean different things; prepare both videos in the same way (both without ggavatar-prep "
            "--tracking, or both with one tracker and one head model) and train on one of them"
        )
    if not same and not force:
        raise InputError(
            f"expected {count} coefficients of {target.head_version!r}, found {driver.expression.shape[1]} of "
            f"{driver.head_version!r}; track both with one head model, or let ggavatar-render --force-basis fill "
            "with zeros and drop surplus coefficients"
        )
    expression = np.zeros((len(driver.frames), count))
    shared = min(count, driver.expression.shape[1])
    expression[:, :shared] = driver.expression[:, :shared]
    return dataclasses.replace(on_head_of(driver, target), expression=expression)


def in_version_of(driver: DrivingSequence, target: DrivingSequence) -> DrivingSequence:
    """The sequence of a file that names a family of heads alone (flame_param.npz) in the version of the target.

    Surplus coefficients that are zero in all frames are dropped, missing ones are zero.
    """
    family = basis_family(target.head_version)
    if driver.head_version != family or driver.head_version == target.head_version:
        return driver
    count, own = target.expression.shape[1], driver.expression
    if not np.any(own[:, count:]):
        own = np.pad(own[:, :count], ((0, 0), (0, max(0, count - own.shape[1]))))
    return dataclasses.replace(driver, head_version=target.head_version, expression=own)


def on_head_of(driver: DrivingSequence, target: DrivingSequence) -> DrivingSequence:
    """The driver's motion in the target's joints and expression axes; those that it lacks stay at zero."""
    count = len(driver.frames)
    expression, joints = np.zeros((count, target.expression.shape[1])), np.zeros((count, len(target.joint_names), 3))
    for index, name in enumerate(target.axis_names):
        if name in driver.axis_names:
            expression[:, index] = driver.expression[:, driver.axis_names.index(name)]
    for index, name in enumerate(target.joint_names):
        if name in driver.joint_names:
            joints[:, index] = driver.joint_rotations[:, driver.joint_names.index(name)]
    return dataclasses.replace(
        driver,
        expression=expression,
        joint_rotations=joints,
        joint_names=target.joint_names,
        head_version=target.head_version,
        axis_names=target.axis_names,
    )


def basis_family(version: str) -> str:
    """The family of a version tag: without a year, number or size at the end (flame2020 → flame)."""
    return re.sub(r"[-_.]?v?\d+([-_.]\d+)*$", "", version.lower())


def drives_and_cameras(sequence: DrivingSequence, head: HeadModel) -> Iterator[tuple[int, Drive, Camera]]:
    """Frame number, drive and camera of every row, on the device of the head; drives refer to no training frame.

    Raises:
        InputError: The sequence has no cameras.
    """
    cameras = sequence.cameras
    if cameras is None:
        raise InputError(
            "expected a driving sequence with cameras, found none; use ggavatar-render --transfer relative"
        )
    for row, frame in enumerate(sequence.frames):
        joints, translation = _tensor(sequence.joint_rotations[row], head), _tensor(sequence.translation[row], head)
        view = _tensor(cameras.world_to_camera[row], head)
        drive = Drive(
            expression=_tensor(sequence.expression[row], head),
            joint_rotations=joints,
            eyelids=_tensor(sequence.eyelids[row], head),
            translation=translation,
            head_to_camera=view @ head_pose(head, joints, translation),
        )
        yield frame, drive, Camera(_tensor(cameras.intrinsics[row], head), view, *cameras.size)


def _tensor(values: np.ndarray, head: HeadModel) -> Tensor:
    return torch.as_tensor(values).to(head.template)
