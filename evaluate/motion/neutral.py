"""Frames that show a person at rest: the face by its codes alone, head and torso by where they point."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from evaluate.motion.driving_sequence import DrivingSequence
from evaluate.motion.facial_codes import FacialLayout, facial_codes, facial_layout

TOWARDS_CAMERA = np.diag([1.0, -1.0, -1.0])
"""Rotation of a head (+Y up, face towards +Z) that faces an OpenCV camera."""


def neutral_row(sequence: DrivingSequence) -> int:
    """Row of the frame whose face is closest to rest, among the half whose heads face the camera best."""
    layout = facial_layout(sequence)
    effort = expression_effort(facial_codes(sequence, layout), layout)
    turned = turn_from_camera(sequence)
    return int(np.argmin(np.where(turned <= np.median(turned), effort, np.inf)))


def facing_row(sequence: DrivingSequence) -> int:
    """Row of the frame whose head faces the camera best, and whose torso stands as it mostly does."""
    torso = [sequence.joint_names.index(name) for name in ("cervical", "torso") if name in sequence.joint_names]
    bent = sequence.joint_rotations[:, torso] - np.median(sequence.joint_rotations[:, torso], axis=0)
    return int(np.argmin(turn_from_camera(sequence) + np.linalg.norm(bent, axis=-1).sum(axis=-1)))


def expression_effort(codes: np.ndarray, layout: FacialLayout) -> np.ndarray:
    """Sum of squared facial codes of every frame, each in units of its deviation; where the eyes look does not count.

    Codes that do not change do not count either.
    """
    gaze = np.concatenate((layout.columns("joint left_eye"), layout.columns("joint right_eye")))
    used = np.setdiff1d(np.arange(codes.shape[1]), gaze)
    deviation = codes[:, used].std(axis=0)
    return np.square(codes[:, used] / np.where(deviation > 1e-9, deviation, np.inf)).sum(axis=1)


def turn_from_camera(sequence: DrivingSequence) -> np.ndarray:
    """Angle between every head and one that faces the camera, rad; without cameras, from the median head."""
    heads = Rotation.identity(len(sequence.frames))
    for name in ("root", "neck"):
        if name in sequence.joint_names:
            heads = heads * Rotation.from_rotvec(sequence.joint_rotations[:, sequence.joint_names.index(name)])
    if sequence.cameras is None:
        return np.asarray((heads * heads.mean().inv()).magnitude())
    views = Rotation.from_matrix(sequence.cameras.world_to_camera[:, :3, :3])
    return np.asarray((Rotation.from_matrix(TOWARDS_CAMERA).inv() * views * heads).magnitude())
