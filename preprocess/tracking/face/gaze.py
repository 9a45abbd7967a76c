"""Turns of the eyeballs from the irises: where the ray through an iris meets the sphere its centre moves on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import Lens, Poses
from preprocess.tracking.geometry.smoothing import penalty, smooth

IRIS_SHARE = 0.87
"""Distance of the iris from the eye's centre over the eyeball's radius."""
LARGEST_TURN = np.radians(40.0)
CLOSED = 0.5
"""Lids closed farther than this hide the iris."""
GAZE_CUTOFF, VERGENCE_CUTOFF = 6.0, 1.0
"""Fastest motion kept of what both eyes do alike, and of the angle between them, Hz."""


def eye_turns(
    irises: Float[np.ndarray, "T 2 2"], lens: Lens, poses: Poses, eyes: Float[np.ndarray, "2 3"], radius: float
) -> Float[np.ndarray, "T 2 3"]:
    """Axis-angle of the left and the right eye in head space, rad, without torsion; at rest an eye looks along +Z.

    Args:
        irises: Image positions of the left and the right iris' centre, px.
        lens: Camera.
        poses: Of the head.
        eyes: Centres of the eyeballs, m in head space.
        radius: Of an eyeball, m.
    """
    rays = np.concatenate(((irises - np.asarray(lens.center)) / lens.focal, np.ones((*irises.shape[:2], 1))), axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    centers = poses.to_camera(eyes[None])
    along = (rays * centers).sum(axis=-1, keepdims=True)
    across = rays * along - centers
    limit = IRIS_SHARE * radius
    distance = np.linalg.norm(across, axis=-1, keepdims=True)
    across = across * np.minimum(1.0, limit * np.sin(LARGEST_TURN) / np.maximum(distance, 1e-9))
    forward = np.sqrt(limit**2 - (across**2).sum(axis=-1, keepdims=True))
    looks = ((across - rays * forward) / limit) @ poses.rotations
    axis = np.stack((-looks[..., 1], looks[..., 0], np.zeros_like(looks[..., 0])), axis=-1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.minimum(np.arctan2(sine, looks[..., 2:]), LARGEST_TURN)
    return axis * (angle / np.maximum(sine, 1e-9))


def centered_eyes(
    turns: Float[np.ndarray, "T 2 3"], poses: Poses, eyes: Float[np.ndarray, "2 3"], radius: float
) -> Float[np.ndarray, "2 3"]:
    """Eye centres shifted so that, in the middle of the clip, both eyes look at the camera's height and distance, m.

    Lids say little about where an eyeball's centre is; but people look about as far as the camera, and mostly at the
    height of the lens. Where they look sideways is left as it is.
    """
    usual = np.median(turns, axis=0)
    camera = np.median(-np.einsum("tba,tb->ta", poses.rotations, poses.translations), axis=0)
    pitch = np.arctan2(-camera[1], camera[2])
    vergence = -(eyes[0, 0] - eyes[1, 0]) / np.linalg.norm(camera)
    reach = IRIS_SHARE * radius
    apart = (usual[0, 1] - usual[1, 1] - vergence) / 2
    raised = (usual[:, 0].mean() - pitch) * reach
    return eyes + np.array([[apart * reach, -raised, 0.0], [-apart * reach, -raised, 0.0]])


def conjugate(
    turns: Float[np.ndarray, "T 2 3"], visible: Float[np.ndarray, " T"], fps: float, smoothed: bool
) -> Float[np.ndarray, "T 2 3"]:
    """Turns of two eyes that move together: raised alike, turned alike but for a vergence that changes slowly.

    Each iris is hard to see by itself (a lid hides part of it, the far side of the face turns it away); people's eyes
    are yoked, so what one shows holds for the other too.

    Args:
        turns: Of the left and the right eye without torsion, rad.
        visible: Weight of each frame, 0 where the irises are hidden; such frames are filled.
        fps: Frames a second.
        smoothed: Smooth over time; else frames stay as they are.
    """
    together, apart = turns.mean(axis=1), (turns[:, 0] - turns[:, 1]) / 2 * np.array([0.0, 1.0, 0.0])
    if smoothed:
        together = smooth(together, visible, penalty(GAZE_CUTOFF, fps))
        apart = smooth(apart, visible, penalty(VERGENCE_CUTOFF, fps))
    return np.stack((together + apart, together - apart), axis=1)
