"""Motion of scalp hair: damped springs that follow the head's pose, in bands of different stiffness."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from preprocess.synthetic.animation.performance import FPS

BANDS = (1.5, 2.3, 3.4)
"""Natural frequencies of the springs, Hz."""
_DAMPING, _STEPS = 0.32, 8


def lagging_poses(head_to_room: Float[ndarray, "T 4 4"], hang: float) -> Float[ndarray, "B T 4 4"]:
    """Poses of damped springs that follow the head's pose, one sequence per band.

    Args:
        head_to_room: Head poses.
        hang: How upright the hair stays when the head tilts, from 0 (like the head) to 1 (like a plumb line).
    """
    upright = _upright(head_to_room, hang)
    target = np.concatenate((Rotation.from_matrix(upright[:, :3, :3]).as_rotvec(), upright[:, :3, 3]), axis=1)
    poses = np.tile(np.eye(4), (len(BANDS), len(target), 1, 1))
    for band, frequency in enumerate(BANDS):
        state = _springs(target, frequency)
        poses[band, :, :3, :3] = Rotation.from_rotvec(state[:, :3]).as_matrix()
        poses[band, :, :3, 3] = state[:, 3:]
    return poses


def _springs(target: ndarray, frequency: float) -> ndarray:
    """Damped oscillators that follow the columns, by semi-implicit Euler with eight steps per frame."""
    omega, step = 2 * np.pi * frequency, 1 / (FPS * _STEPS)
    place, speed = target[0].copy(), np.zeros(target.shape[1])
    result = np.empty_like(target)
    for frame in range(len(target)):
        before = target[max(frame - 1, 0)]
        for substep in range(_STEPS):
            goal = before + (target[frame] - before) * (substep + 1) / _STEPS
            speed = speed + step * (omega**2 * (goal - place) - 2 * _DAMPING * omega * speed)
            place = place + step * speed
        result[frame] = place
    return result


def _upright(poses: ndarray, hang: float) -> ndarray:
    """Poses with pitch and roll reduced by `hang` about the middle of the head, so that long hair hangs straight."""
    if hang <= 0:
        return poses
    turned = Rotation.from_matrix(poses[:, :3, :3])
    forwards = turned.as_matrix()[:, :, 2]
    level = Rotation.from_rotvec(np.arctan2(forwards[:, :1], forwards[:, 2:]) * (0.0, 1.0, 0.0))
    result = poses.copy()
    pivot = np.array([0.0, 0.06, -0.03])
    for frame in range(len(poses)):
        between = Slerp([0.0, 1.0], Rotation.concatenate((turned[frame : frame + 1], level[frame : frame + 1])))
        rotation = between(hang).as_matrix()
        result[frame, :3, :3] = rotation
        result[frame, :3, 3] = poses[frame, :3, :3] @ pivot + poses[frame, :3, 3] - rotation @ pivot
    return result


def swing_hair(
    nodes: Float[ndarray, "S N 3"], head: Float[ndarray, "4 4"], lags: Float[ndarray, "B 4 4"], flex: float
) -> Float[ndarray, "S N 3"]:
    """Strand nodes in the room, m: roots on the head, tips blended towards their band's lagging pose by `flex`.

    Strand i belongs to band i modulo the number of bands.
    """
    at_head = nodes @ head[:3, :3].T + head[:3, 3]
    if flex <= 0:
        return at_head
    share = np.linspace(0, 1, nodes.shape[1])[None, :, None] ** 1.5
    length = np.linalg.norm(nodes[:, -1] - nodes[:, 0], axis=1)[:, None, None]
    loose = flex * share * np.clip(length / 0.06, 0.1, 1.0)
    result = at_head.copy()
    for band, pose in enumerate(lags):
        chosen = slice(band, None, len(lags))
        lagging = nodes[chosen] @ pose[:3, :3].T + pose[:3, 3]
        result[chosen] += loose[chosen] * (lagging - at_head[chosen])
    return result
