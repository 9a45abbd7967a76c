"""A live performance: what one picture of a face makes an avatar do, relative to the performer at rest.

The transfer is that of recorded performances (`evaluate.motion.transfer.match_performance`), one frame at a time: what
the face shows by its expression scores, the head's pose by its change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from evaluate.motion.driving_sequence import Cameras, DrivingSequence
from evaluate.motion.expression_transfer import carry_over
from evaluate.motion.face import SCORES, Face, face_of
from evaluate.motion.facial_codes import facial_layout, with_facial_codes
from evaluate.motion.neutral import facing_row
from evaluate.motion.retarget import drives_and_cameras
from evaluate.motion.smoothing import OneEuro
from evaluate.motion.transfer import TransferOptions, carried_cameras, limit_to_training_range
from ggavatar.core import Camera, Drive
from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel
from ggavatar.landmarks.average_face import average_face

ASSUMED_FOCAL = 1.2
"""Focal length of an unknown camera, relative to the longer side of its picture; about 45 degrees wide."""
STEADY_ABOVE = -0.02
"""Height in the average face from which landmarks do not move with mouth and jaw, m."""
SCORE_UNIT, ANGLE_UNIT, PLACE_UNIT = 0.1, 0.1, 0.02
"""In which the filter measures speeds: of scores, of angles (rad) and of places (m)."""
_POINTS = average_face().vertices
_STEADY = np.flatnonzero(_POINTS[:, 1] > STEADY_ABOVE)


@dataclass(frozen=True)
class Look:
    """What one picture of a performer shows.

    Attributes:
        scores: Expression scores in the order of `evaluate.motion.face.SCORES`.
        rotation: Of the head in the camera's space, as rotation vector, rad.
        translation: Of the head in the camera's space, m.
    """

    scores: Float[np.ndarray, " S"]
    rotation: Float[np.ndarray, "3"]
    translation: Float[np.ndarray, "3"]

    def numbers(self) -> Float[np.ndarray, " N"]:
        """All of them in one row."""
        return np.concatenate((self.scores, self.rotation, self.translation))

    @staticmethod
    def of(numbers: Float[np.ndarray, " N"]) -> Look:
        """The inverse of `numbers`."""
        return Look(numbers[:-6], numbers[-6:-3], numbers[-3:])


def assumed_intrinsics(width: int, height: int) -> Float[np.ndarray, "3 3"]:
    """The camera matrix that is assumed for a picture of an unknown camera, px."""
    focal = ASSUMED_FOCAL * max(width, height)
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])


def look_of(scores: Float[np.ndarray, "52"], points: Float[np.ndarray, "478 2"], size: tuple[int, int]) -> Look | None:
    """What scores and landmarks say; None if no pose of the head explains the landmarks.

    Args:
        scores: In the order of `ggavatar.landmarks.blendshapes.NAMES`.
        points: Landmarks, px (pixel centers at +0.5).
        size: Width and height of the picture, px.
    """
    lens, steady = assumed_intrinsics(*size), points[_STEADY].astype(np.float64)
    try:
        found, rotation, translation = cv2.solvePnP(_POINTS[_STEADY], steady, lens, None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # all landmarks in one place
        return None
    if not found or not np.isfinite(rotation).all() or not np.isfinite(translation).all() or translation[2, 0] <= 0:
        return None
    return Look(scores[1:].astype(np.float64), rotation[:, 0], translation[:, 0])


def mean_look(looks: Sequence[Look]) -> Look:
    """The mean of some looks, as of a performer at rest."""
    turns = Rotation.from_rotvec([look.rotation for look in looks]).mean().as_rotvec()
    numbers = np.mean([look.numbers() for look in looks], axis=0)
    return dataclasses.replace(Look.of(numbers), rotation=turns)


class LookFilter:
    """Steadies looks that come one by one; rotations relative to the first, far from where their vectors wrap."""

    def __init__(self) -> None:
        self._filter = OneEuro(np.repeat([SCORE_UNIT, ANGLE_UNIT, PLACE_UNIT], [len(SCORES), 3, 3]))
        self._base: Rotation | None = None

    def __call__(self, look: Look, seconds: float) -> Look:
        """The steadied look; `seconds` have passed since the one before."""
        turn = Rotation.from_rotvec(look.rotation)
        base = self._base = self._base or turn
        relative = dataclasses.replace(look, rotation=(turn * base.inv()).as_rotvec())
        smooth = Look.of(self._filter(relative.numbers(), seconds))
        return dataclasses.replace(smooth, rotation=(Rotation.from_rotvec(smooth.rotation) * base).as_rotvec())


class LiveTransfer:
    """Makes an avatar do what looks show."""

    def __init__(self, target: DrivingSequence, head: HeadModel, how: TransferOptions | None = None) -> None:
        """Learn what the avatar's face shows for its codes.

        Args:
            target: Frames that the avatar was trained on, with scores.
            head: The avatar's head.
            how: Limits; by default those of recorded performances.

        Raises:
            InputError: The scores of the target are not known.
        """
        if target.scores is None:
            raise InputError(
                "expected the face of the avatar's own video to be measured, found no face in it that the landmark "
                "network recognizes; drive this avatar by recorded parameters (ggavatar-render --drive)"
            )
        known = np.isfinite(target.scores).all(axis=1)
        self._target, self._head = target.rows(known), head
        self._margin = (how or TransferOptions()).margin
        self._face = face_of(self._target)
        self._layout = facial_layout(self._target)
        self._row = facing_row(self._target)

    def __call__(self, look: Look, rest: Look, size: tuple[int, int]) -> tuple[Drive, Camera]:
        """Drive and camera for a look.

        Args:
            look: Of now.
            rest: Of the performer at rest.
            size: Of the pictures that both are from, px.
        """
        goal = self._target.rows(slice(self._row, self._row + 1))
        codes = carry_over(self._performer(look, rest), self._face)
        views = [_view(one, size) for one in (look, rest)]
        driver = dataclasses.replace(goal, cameras=views[0])
        cameras = carried_cameras(driver, views[1], goal.cameras, "relative")
        moved = with_facial_codes(dataclasses.replace(goal, cameras=cameras), self._layout, codes)
        if self._margin is not None:
            moved = limit_to_training_range(moved, self._target, self._row, self._margin)
        _, drive, camera = next(drives_and_cameras(moved, self._head))
        return dataclasses.replace(drive, frame=None), camera

    def _performer(self, look: Look, rest: Look) -> Face:
        """The performer's face: scores now and at rest, and no codes."""
        nothing = np.zeros((1, 0))
        layout = dataclasses.replace(self._layout, names=(), shared=(), expressions=(), joints=())
        return Face(layout, nothing, look.scores[None], None, np.zeros((0, 0)), np.zeros(0), rest.scores)


def _view(look: Look, size: tuple[int, int]) -> Cameras:
    """The performer's camera, in whose space the head's pose is."""
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = Rotation.from_rotvec(look.rotation).as_matrix(), look.translation
    return Cameras(view[None], assumed_intrinsics(*size)[None], size)
