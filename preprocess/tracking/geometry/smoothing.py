"""Smoothing without lag (Whittaker), and measures of jitter."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from preprocess.tracking.geometry.rigid import RigidPoses, second_difference_stencil


def penalty(cutoff: float, fps: float) -> float:
    """Penalty on squared second differences with which Whittaker's smoother halves a motion of `cutoff` Hz.

    The cutoff is limited to a third of the frame rate.
    """
    angle = np.pi * min(cutoff, fps / 3) / fps
    return float((2 * np.sin(angle)) ** -4)


def smooth(
    values: Float[np.ndarray, "T C"], weights: Float[np.ndarray, " T"], strength: float
) -> Float[np.ndarray, "T C"]:
    """Whittaker's smoother: weighted least squares with squared second differences penalized by `strength`.

    Frames of weight zero are filled by the smoothest continuation. The smoother is symmetric in time, so it has no lag.
    """
    if len(values) < 3 or strength <= 0:
        return values.copy()
    bands = strength * second_difference_stencil(len(values))
    bands[0] += weights + 1e-9
    return solveh_banded(bands, weights[:, None] * np.where(weights[:, None] > 0, values, 0.0), lower=True)


def jitter(values: Float[np.ndarray, "T C"]) -> float:
    """Standard deviation of the white noise in a track: a robust estimate from fourth differences over √70."""
    if len(values) < 5:
        return 0.0
    differences = np.diff(values, n=4, axis=0) / np.sqrt(70.0)
    return float(
        np.sqrt((1.4826 * np.median(np.abs(differences), axis=0)) @ (1.4826 * np.median(np.abs(differences), axis=0)))
    )


def pose_jitter(poses: RigidPoses) -> dict[str, float]:
    """Jitter of head poses: rotation in degrees, translation across and along the viewing direction in millimeters."""
    rotations = Rotation.from_matrix(poses.rotations)
    middle = rotations[len(rotations) // 2].inv()
    degrees = np.degrees((middle * rotations).as_rotvec())
    millimeters = poses.translations * 1000
    return {
        "rotation_deg": jitter(degrees),
        "across_mm": jitter(millimeters[:, :2]),
        "along_mm": jitter(millimeters[:, 2:]),
    }
