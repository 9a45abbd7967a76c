"""Drives for which an avatar is exported: neutral, those of frames of its capture, or those of a parameter file."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.data.frames import head_pose
from ggavatar.errors import InputError
from ggavatar.formats.flame_parameters import read_flame_parameters
from ggavatar.geometry.transforms import invert_rigid
from ggavatar.head.flame import JOINT_NAMES
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.io.npz import npz_headers, read_npz
from ggavatar.training.run_folder import Run

MAX_ABSOLUTE_VALUE = 1e4
"""Larger numbers mean that a file is damaged."""


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


def file_drives(path: Path, run: Run, head: HeadModel) -> list[NamedDrive]:
    """The drives in a file of head parameters: of `ggavatar-render --drive` (docs/rendering.md), or flame_param.npz.

    Coefficients are used as they are. Joints that the file does not have are at rest; its cameras are not used.

    Raises:
        InputError: The file is neither of the two, or its parameters are those of another head.
    """
    if path.suffix.lower() != ".npz" or not path.is_file():
        raise InputError(f"{path}: expected an .npz of head parameters, found none; see Driving in docs/rendering.md")
    flame = "expr" in npz_headers(path)
    if flame and (not head.version.startswith("flame") or head.joint_names[:5] != JOINT_NAMES):
        raise InputError(
            f"{path}: expected parameters of the head {head.version!r}, found those of FLAME; use parameters that were "
            "tracked with the head of the run"
        )
    drives = read_flame_parameters(path).drives(head) if flame else _read_drives(path, head)
    trained = [run.reader.drive(number) for number in run.split.train]
    view = mean_training_view(head, HeadPoses.of(head, trained), trained)
    return [
        NamedDrive(f"{row:06d}", dataclasses.replace(drive, head_to_camera=view @ drive.head_to_camera))
        for row, drive in enumerate(drives)
    ]


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


def _read_drives(path: Path, head: HeadModel) -> list[Drive]:
    """Drives whose `head_to_camera` is the head's pose in world space."""
    arrays = read_npz(path, ("expression", "version", "joint_rotations", "joint_names", "eyelids", "translation"))
    if str(arrays.get("version")) != head.version:
        raise InputError(
            f"{path}: expected 'version' to be {head.version!r}, the head of the run, found {arrays.get('version')}; "
            "use parameters that were tracked with this head"
        )
    if "expression" not in arrays or arrays["expression"].ndim != 2:
        found = f"shape {arrays['expression'].shape}" if "expression" in arrays else "no such array"
        raise InputError(f"{path}: expected 'expression' of shape (T, {head.expression_basis.shape[2]}), found {found}")
    count = len(arrays["expression"])
    names = [str(name) for name in np.atleast_1d(arrays.get("joint_names", np.array([], str)))]
    rotations = np.zeros((count, len(head.parents), 3), np.float32)
    given = _numbers(path, arrays, "joint_rotations", (count, len(names), 3))
    for index, name in enumerate(names):
        if name in head.joint_names:
            rotations[:, head.joint_names.index(name)] = given[:, index]
    values = (
        _numbers(path, arrays, "expression", (count, head.expression_basis.shape[2])),
        rotations,
        _numbers(path, arrays, "eyelids", (count, 2)),
        _numbers(path, arrays, "translation", (count, 3)),
    )
    columns = [torch.from_numpy(value).to(head.template) for value in values]
    return [
        Drive(psi, theta, lids, move, head_pose(head, theta, move))
        for psi, theta, lids, move in zip(*columns, strict=True)
    ]


def _numbers(path: Path, arrays: dict[str, ndarray], name: str, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    """A checked array as float32; zeros, which move nothing, if it is absent."""
    array = arrays.get(name, np.zeros(shape, np.float32))
    if array.shape != shape or 0 in shape[:1]:
        raise InputError(f"{path}: expected {name!r} of shape {shape}, found {array.shape}")
    if array.dtype.kind not in "fiu" or not (np.abs(array) < MAX_ABSOLUTE_VALUE).all():
        raise InputError(f"{path}: expected finite numbers below {MAX_ABSOLUTE_VALUE:g} in {name!r}, found others")
    return array.astype(np.float32)
