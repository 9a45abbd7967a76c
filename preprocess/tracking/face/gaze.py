"""Gaze: rotations of the eyeballs from the irises, by intersecting the ray through an iris with its sphere."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import PinholeIntrinsics, RigidPoses
from preprocess.tracking.geometry.smoothing import penalty, smooth

IRIS_DEPTH_RATIO = 0.87
"""Distance of the iris from the eye's center over the eyeball's radius."""
MAXIMUM_EYE_ROTATION = np.radians(40.0)
CLOSED_LID = 0.5
"""Lid value above which the iris is considered hidden."""
GAZE_CUTOFF, VERGENCE_CUTOFF = 6.0, 1.0
"""Fastest motion that is kept of the common rotation, and of the angle between the eyes, Hz."""


def eye_rotations(
    irises: Float[np.ndarray, "T 2 2"],
    intrinsics: PinholeIntrinsics,
    poses: RigidPoses,
    eyes: Float[np.ndarray, "2 3"],
    radius: float,
) -> Float[np.ndarray, "T 2 3"]:
    """Axis-angle of the left and the right eye in head space, rad, without torsion; at rest an eye looks along +Z.

    Args:
        irises: Image positions of the centers of the left and the right iris, px.
        intrinsics: Of the camera.
        poses: Of the head.
        eyes: Centers of the eyeballs, m in head space.
        radius: Of an eyeball, m.
    """
    rays = np.concatenate(
        ((irises - np.asarray(intrinsics.center)) / intrinsics.focal, np.ones((*irises.shape[:2], 1))), axis=-1
    )
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    centers = poses.to_camera(eyes[None])
    along = (rays * centers).sum(axis=-1, keepdims=True)
    across = rays * along - centers
    limit = IRIS_DEPTH_RATIO * radius
    distance = np.linalg.norm(across, axis=-1, keepdims=True)
    across = across * np.minimum(1.0, limit * np.sin(MAXIMUM_EYE_ROTATION) / np.maximum(distance, 1e-9))
    forward = np.sqrt(limit**2 - (across**2).sum(axis=-1, keepdims=True))
    directions = ((across - rays * forward) / limit) @ poses.rotations
    axis = np.stack((-directions[..., 1], directions[..., 0], np.zeros_like(directions[..., 0])), axis=-1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.minimum(np.arctan2(sine, directions[..., 2:]), MAXIMUM_EYE_ROTATION)
    return axis * (angle / np.maximum(sine, 1e-9))


def centered_eyeballs(
    rotations: Float[np.ndarray, "T 2 3"], poses: RigidPoses, eyes: Float[np.ndarray, "2 3"], radius: float
) -> Float[np.ndarray, "2 3"]:
    """Eye centers (m) moved so that the median gaze is at the camera's height and converges at its distance.

    Lids constrain the center of an eyeball only weakly; but people look about as far as the camera, and mostly at its
    height. The direction of the gaze sideways is left as it is.
    """
    median = np.median(rotations, axis=0)
    camera = np.median(-np.einsum("tba,tb->ta", poses.rotations, poses.translations), axis=0)
    pitch = np.arctan2(-camera[1], camera[2])
    vergence = -(eyes[0, 0] - eyes[1, 0]) / np.linalg.norm(camera)
    iris_radius = IRIS_DEPTH_RATIO * radius
    apart = (median[0, 1] - median[1, 1] - vergence) / 2
    raised = (median[:, 0].mean() - pitch) * iris_radius
    return eyes + np.array([[apart * iris_radius, -raised, 0.0], [-apart * iris_radius, -raised, 0.0]])


def conjugate_gaze(
    rotations: Float[np.ndarray, "T 2 3"], visible: Float[np.ndarray, " T"], fps: float, smoothed: bool
) -> Float[np.ndarray, "T 2 3"]:
    """Rotations of two eyes that move conjugately: equal pitch, and equal yaw but for a slowly changing vergence.

    A single iris is measured poorly (a lid hides part of it, or it is on the far side of the face); eye movements are
    yoked, so each eye is evidence for the other.

    Args:
        rotations: Of the left and the right eye without torsion, axis-angle, rad.
        visible: Weight of each frame, 0 where the irises are hidden; such frames are filled if `smoothed`.
        fps: Frames per second.
        smoothed: Smooth over time.
    """
    together, apart = rotations.mean(axis=1), (rotations[:, 0] - rotations[:, 1]) / 2 * np.array([0.0, 1.0, 0.0])
    if smoothed:
        together = smooth(together, visible, penalty(GAZE_CUTOFF, fps))
        apart = smooth(apart, visible, penalty(VERGENCE_CUTOFF, fps))
    return np.stack((together + apart, together - apart), axis=1)
