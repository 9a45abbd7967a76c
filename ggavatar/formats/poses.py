"""In which poses an avatar is exported: neutral, as in frames of its capture, or as a file of parameters says."""

from __future__ import annotations

import dataclasses
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

LARGEST = 1e4


class Pose(NamedTuple):
    """A drive and the name of the file it is written to."""

    name: str
    drive: Drive


def neutral_pose(run: Run, head: HeadModel) -> Pose:
    """No expression, nothing turned; where a method asks for the head's pose, the mean one of the training frames."""
    poses = HeadPoses.of(head, [run.reader.drive(number) for number in run.split.train])
    return Pose("neutral", dataclasses.replace(head.neutral_drive(), head_to_camera=poses.reference))


def frame_poses(run: Run, frames: tuple[int, ...]) -> list[Pose]:
    """The poses of source frames; `InputError` if the capture has no such frame."""
    return [Pose(f"frame-{number:06d}", run.reader.drive(number)) for number in frames]


def file_poses(path: Path, run: Run, head: HeadModel) -> list[Pose]:
    """The rows of a file of parameters: that of `ggavatar-render --drive` (docs/rendering.md) or a flame_param.npz.

    Coefficients are used as they are. Joints that the file lacks rest; its cameras are not used.

    Raises:
        InputError: Neither of the two, or parameters of another head.
    """
    if path.suffix.lower() != ".npz" or not path.is_file():
        raise InputError(f"{path}: expected an .npz of head parameters, found none (docs/rendering.md, Driving)")
    flame = "expr" in npz_headers(path)
    if flame and (not head.version.startswith("flame") or head.joint_names[:5] != JOINT_NAMES):
        raise InputError(
            f"{path}: expected parameters of the head {head.version!r}, found FLAME's; track with its head"
        )
    drives = read_flame_parameters(path).drives(head) if flame else _own_layout(path, head)
    view = _usual_view(run, head)
    return [
        Pose(f"{row:06d}", dataclasses.replace(drive, head_to_camera=view @ drive.head_to_camera))
        for row, drive in enumerate(drives)
    ]


def _usual_view(run: Run, head: HeadModel) -> Float[Tensor, "4 4"]:
    """A camera in front of the head that asks nothing unseen of a method: the mean pose of training, head at rest."""
    drives = [run.reader.drive(number) for number in run.split.train]
    poses = HeadPoses.of(head, drives)
    if poses.in_camera or not drives:
        return poses.reference
    return drives[0].head_to_camera @ invert_rigid(head_pose(head, drives[0].joint_rotations, drives[0].translation))


def _own_layout(path: Path, head: HeadModel) -> list[Drive]:
    """Drives seen from the head's origin."""
    arrays = read_npz(path, ("expression", "version", "joint_rotations", "joint_names", "eyelids", "translation"))
    if str(arrays.get("version")) != head.version:
        raise InputError(
            f"{path}: expected 'version' to be {head.version!r}, the head of the run, found {arrays.get('version')}; "
            "numbers of other heads mean different things"
        )
    if "expression" not in arrays or arrays["expression"].ndim != 2:
        raise InputError(f"{path}: expected 'expression' of shape T×{head.expression_basis.shape[2]}, found none")
    count = len(arrays["expression"])
    names = [str(name) for name in np.atleast_1d(arrays.get("joint_names", np.array([], str)))]
    turns = np.zeros((count, len(head.parents), 3), np.float32)
    given = _numbers(path, arrays, "joint_rotations", (count, len(names), 3))
    for index, name in enumerate(names):
        if name in head.joint_names:
            turns[:, head.joint_names.index(name)] = given[:, index]
    values = (
        _numbers(path, arrays, "expression", (count, head.expression_basis.shape[2])),
        turns,
        _numbers(path, arrays, "eyelids", (count, 2)),
        _numbers(path, arrays, "translation", (count, 3)),
    )
    columns = [torch.from_numpy(value).to(head.template) for value in values]
    return [
        Drive(psi, theta, lids, move, head_pose(head, theta, move))
        for psi, theta, lids, move in zip(*columns, strict=True)
    ]


def _numbers(path: Path, arrays: dict[str, ndarray], name: str, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    """A checked array as float32; one that is absent is zero, which moves nothing."""
    array = arrays.get(name, np.zeros(shape, np.float32))
    if array.shape != shape or 0 in shape[:1]:
        raise InputError(f"{path}: expected {name!r} of shape {shape}, found {array.shape}")
    if array.dtype.kind not in "fiu" or not (np.abs(array) < LARGEST).all():
        raise InputError(f"{path}: expected finite numbers below {LARGEST:g} in {name!r}, found others")
    return array.astype(np.float32)
