"""Small rigid steps of tracked poses: a turn about a point of the moving thing itself, and a shift in the camera."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def stepped(
    poses: Float[np.ndarray, "T 4 4"], pivots: Float[np.ndarray, "T 3"], steps: Float[np.ndarray, "T 6"]
) -> Float[np.ndarray, "T 4 4"]:
    """Rigid poses turned about pivots that move with them, and shifted.

    A turn about the camera instead would also shift the thing by its distance times the angle: 1° at 0.8 m is 14 mm.

    Args:
        poses: Transforms to the camera, m.
        pivots: Point that a turn leaves where it is, in the space that the poses transform, m.
        steps: Axis-angle about the axes of that space (rad), and a shift along the camera's axes (m).
    """
    turned = poses[:, :3, :3] @ Rotation.from_rotvec(steps[:, :3]).as_matrix()
    result = poses.copy()
    result[:, :3, :3] = turned
    result[:, :3, 3] += steps[:, 3:] + np.einsum("tij,tj->ti", poses[:, :3, :3] - turned, pivots)
    return result
