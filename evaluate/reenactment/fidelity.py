"""Measures of a reenactment: whether expression scores and head of the avatar follow those of the driver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from evaluate.motion.score_agreement import Agreement, agreement


@dataclass(frozen=True)
class Fidelity:
    """How the scores of an avatar follow those of its driver.

    Attributes:
        agreement: Correlation and slope of the avatar's scores over the driver's; a slope of 1 is the whole expression.
        expression_distance: Mean absolute difference of the scores (AED).
    """

    agreement: Agreement
    expression_distance: float


def score_fidelity(driver: Float[np.ndarray, "T S"], avatar: Float[np.ndarray, "T S"]) -> Fidelity:
    """Compare scores frame by frame; frames where either has no face (NaN) do not count.

    Raises:
        ValueError: Fewer than two frames show both faces.
    """
    known = np.isfinite(driver).all(axis=1) & np.isfinite(avatar).all(axis=1)
    if known.sum() < 2:
        raise ValueError(f"expected two frames or more with both faces, got {known.sum()}")
    first, second = driver[known], avatar[known]
    return Fidelity(agreement(first, second), float(np.abs(first - second).mean()))


def pose_distance(driver: Float[np.ndarray, "T 3 3"], avatar: Float[np.ndarray, "T 3 3"]) -> float:
    """Mean angle between the turns of two heads from their mean orientation (APD), degrees; NaN rows do not count."""
    known = np.isfinite(driver).all(axis=(1, 2)) & np.isfinite(avatar).all(axis=(1, 2))
    turns = [Rotation.from_matrix(heads[known]) for heads in (driver, avatar)]
    from_mean = [turn * turn.mean().inv() for turn in turns]
    return float(np.degrees((from_mean[0] * from_mean[1].inv()).magnitude()).mean())


def landmark_jitter(points: Float[np.ndarray, "T L 2"], frames: tuple[int, ...], eyes: tuple[int, int]) -> float | None:
    """Mean second difference of landmarks over consecutive frames, in distances between the outer corners of the eyes.

    None if no three consecutive frames show a face.
    """
    numbers = np.asarray(frames)
    middle = np.flatnonzero((np.diff(numbers)[:-1] == 1) & (np.diff(numbers)[1:] == 1)) + 1
    second = points[middle - 1] - 2 * points[middle] + points[middle + 1]
    width = np.linalg.norm(points[middle, eyes[0]] - points[middle, eyes[1]], axis=-1)
    values = np.linalg.norm(second, axis=-1).mean(axis=-1) / width
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def head_rotation(points: Float[np.ndarray, "L 3"], face: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation that takes a face to landmarks (least squares over rotation, scale and position).

    Args:
        points: Landmarks with depth, px; +X right, +Y down, +Z away.
        face: The same landmarks of a face at rest; +X right, +Y down, +Z away as well.
    """
    covariance = (points - points.mean(axis=0)).T @ (face - face.mean(axis=0))
    left, _, right = np.linalg.svd(covariance)
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return left @ handed @ right
