"""Convention mistakes that trackings are often written with, and their corrections: the names that `--fix` takes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ggavatar.data.capture import Tracking
from ggavatar.errors import InputError

Correction = Callable[[Tracking, int, int], Tracking]
"""Maps a tracking and the capture's width and height in px to the corrected tracking."""


@dataclass(frozen=True)
class Hypothesis:
    """A convention mistake that is often made.

    Attributes:
        name: The value of `--fix` that undoes it.
        description: The mistake as a clause about the tracking.
        correct: Undoes it.
    """

    name: str
    description: str
    correct: Correction


def _axes(signs: tuple[int, int, int]) -> Correction:
    """Flip camera axes; if that is a reflection, mirror the head's left and right too, so that poses stay rigid."""
    camera = np.diag(signs).astype(float)
    head = np.diag([float(np.prod(signs)), 1.0, 1.0])

    def correct(tracking: Tracking, width: int, height: int) -> Tracking:
        poses = tracking.world_to_camera.astype(np.float64)
        poses[:, :3, :3] = camera @ poses[:, :3, :3] @ head
        poses[:, :3, 3] = poses[:, :3, 3] @ camera
        moved = tracking.translation @ head
        return dataclasses.replace(tracking, world_to_camera=poses, translation=moved)

    return correct


def _distance(factor: float) -> Correction:
    def correct(tracking: Tracking, width: int, height: int) -> Tracking:
        poses = tracking.world_to_camera.astype(np.float64)
        poses[:, :3, 3] *= factor
        return dataclasses.replace(tracking, world_to_camera=poses, translation=tracking.translation * factor)

    return correct


def _inverted(tracking: Tracking, width: int, height: int) -> Tracking:
    """Invert the poses: camera-to-world was given in place of world-to-camera."""
    poses = tracking.world_to_camera.astype(np.float64)
    turned = poses[:, :3, :3].transpose(0, 2, 1)
    result = poses.copy()
    result[:, :3, :3], result[:, :3, 3] = turned, -np.einsum("tij,tj->ti", turned, poses[:, :3, 3])
    return dataclasses.replace(tracking, world_to_camera=result)


def _transposed(tracking: Tracking, width: int, height: int) -> Tracking:
    """Transpose the rotations: 6D rotations were read as columns, or row vectors taken for column vectors."""
    poses = tracking.world_to_camera.astype(np.float64)
    poses[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    return dataclasses.replace(tracking, world_to_camera=poses)


def _centered(tracking: Tracking, width: int, height: int) -> Tracking:
    intrinsics = tracking.intrinsics.copy()
    intrinsics[:, 0, 2], intrinsics[:, 1, 2] = width / 2, height / 2
    return dataclasses.replace(tracking, intrinsics=intrinsics)


def _size_swapped(tracking: Tracking, width: int, height: int) -> Tracking:
    intrinsics = tracking.intrinsics.copy()
    intrinsics[:, 0] *= width / height
    intrinsics[:, 1] *= height / width
    return dataclasses.replace(tracking, intrinsics=intrinsics)


def _eyes_swapped(tracking: Tracking, width: int, height: int) -> Tracking:
    joints = tracking.joint_rotations.copy()
    joints[:, [3, 4]] = joints[:, [4, 3]]
    return dataclasses.replace(tracking, joint_rotations=joints)


def _as_is(tracking: Tracking, width: int, height: int) -> Tracking:
    return tracking


AS_IS = Hypothesis("as-is", "the tracking follows our conventions", _as_is)

AXES = (
    AS_IS,
    Hypothesis("axes+--", "its cameras have OpenGL's axes (y up, z backwards)", _axes((1, -1, -1))),
    Hypothesis("axes--+", "its cameras have PyTorch3D's axes (x left, y up)", _axes((-1, -1, 1))),
    Hypothesis("axes-+-", "its cameras look backwards (x left, z backwards)", _axes((-1, 1, -1))),
    Hypothesis("axes-++", "its handedness is wrong: left and right are mirrored", _axes((-1, 1, 1))),
    Hypothesis("axes+-+", "its handedness is wrong: y points up in a left-handed camera", _axes((1, -1, 1))),
    Hypothesis("axes++-", "its handedness is wrong: z points backwards in a left-handed camera", _axes((1, 1, -1))),
    Hypothesis("axes---", "its handedness is wrong: all axes of the camera are reversed", _axes((-1, -1, -1))),
)
"""The eight axis and handedness hypotheses, the first of which is no mistake; all keep poses rigid."""

OTHERS = (
    Hypothesis("inverted", "its poses are camera-to-world, not world-to-camera", _inverted),
    Hypothesis("transposed", "its rotations are transposed (columns in place of rows)", _transposed),
    Hypothesis("distance/4", "its lengths are four times too large, as in the IMavatar family (×4)", _distance(0.25)),
    Hypothesis("distance*4", "its lengths are four times too small", _distance(4.0)),
    Hypothesis("distance/1000", "its lengths are in millimeters, not meters", _distance(1e-3)),
    Hypothesis("centre", "its principal point was not scaled or moved with the images", _centered),
    Hypothesis("swapped-size", "its image size is (height, width) taken for (width, height)", _size_swapped),
)

"""Other hypotheses that silhouettes can test."""

EYES = Hypothesis("swapped-eyes", "its left and right eye are swapped", _eyes_swapped)

FIXES = {hypothesis.name: hypothesis for hypothesis in (*AXES[1:], *OTHERS, EYES)}


def apply_fixes(tracking: Tracking, names: Sequence[str], width: int, height: int) -> Tracking:
    """Undo the mistakes that `--fix` names, in the given order.

    Raises:
        InputError: An unknown name.
    """
    for name in names:
        if name not in FIXES:
            raise InputError(f"--fix {name}: expected one of {', '.join(FIXES)}; ggavatar-doctor reports which")
        tracking = FIXES[name].correct(tracking, width, height)
    return tracking
