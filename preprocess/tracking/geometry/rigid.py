"""Rigid head poses from landmarks of a known, possibly deforming shape: PnP, robust refinement, smoothing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from ggavatar.geometry.transforms import skew

POSE_SIZE = 6
"""Degrees of freedom of a pose: a small rotation about the camera's axes (rad), then a translation (m)."""
CHUNK = 256
"""Frames that are processed at a time, to bound memory."""


@dataclass(frozen=True)
class PinholeIntrinsics:
    """Intrinsics of a pinhole camera with square pixels and no distortion.

    Attributes:
        focal: Focal length, px.
        center: Principal point, px.
    """

    focal: float
    center: tuple[float, float]

    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """As a 3 × 3 matrix, px."""
        return np.array([[self.focal, 0, self.center[0]], [0, self.focal, self.center[1]], [0, 0, 1.0]])


@dataclass(frozen=True)
class RigidPoses:
    """Rigid head-to-camera transforms: x ↦ rotation x + translation.

    Attributes:
        rotations: Head axes in camera axes.
        translations: Head origin in camera space, m.
    """

    rotations: Float[np.ndarray, "T 3 3"]
    translations: Float[np.ndarray, "T 3"]

    def __getitem__(self, frames: slice | np.ndarray) -> RigidPoses:
        return RigidPoses(self.rotations[frames], self.translations[frames])

    def to_camera(self, points: Float[np.ndarray, "#T N 3"]) -> Float[np.ndarray, "T N 3"]:
        """Head-space points in camera space, m."""
        return points @ self.rotations.transpose(0, 2, 1) + self.translations[:, None]

    def moved(self, steps: Float[np.ndarray, "T 6"]) -> RigidPoses:
        """Rotated by small angles about the camera's axes (rad) and translated (m)."""
        rotations = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        return RigidPoses(rotations @ self.rotations, self.translations + steps[:, 3:])

    def matrices(self) -> Float[np.ndarray, "T 4 4"]:
        """As rigid 4 × 4 matrices."""
        matrices = np.tile(np.eye(4), (len(self.rotations), 1, 1))
        matrices[:, :3, :3] = self.rotations
        matrices[:, :3, 3] = self.translations
        return matrices


@dataclass(frozen=True)
class LandmarkObservations:
    """Landmarks of a clip with their variances.

    Attributes:
        points: Image positions, px; finite even where no face was found.
        weights: Inverse variance of each point, 1/px²; zero where no face was found.
    """

    points: Float[np.ndarray, "T N 2"]
    weights: Float[np.ndarray, "T N"]

    def __getitem__(self, frames: slice | np.ndarray) -> LandmarkObservations:
        return LandmarkObservations(self.points[frames], self.weights[frames])


def project_to_pixels(points: Float[np.ndarray, "T N 3"], intrinsics: PinholeIntrinsics) -> Float[np.ndarray, "T N 2"]:
    """Image positions of camera-space points, px."""
    return intrinsics.focal * points[..., :2] / points[..., 2:] + np.asarray(intrinsics.center)


def projection_jacobian(points: Float[np.ndarray, "T N 3"], focal: float) -> Float[np.ndarray, "T N 2 3"]:
    """Derivative of the image position with respect to the camera-space point, px/m."""
    jacobian = np.zeros((*points.shape[:2], 2, 3))
    inverse = focal / points[..., 2]
    jacobian[..., 0, 0] = jacobian[..., 1, 1] = inverse
    jacobian[..., :, 2] = -inverse[..., None] * points[..., :2] / points[..., 2:]
    return jacobian


def pose_jacobian(
    points: Float[np.ndarray, "T N 3"], poses: RigidPoses, by_point: Float[np.ndarray, "T N 2 3"]
) -> Float[np.ndarray, "T N 2 6"]:
    """Derivative of the image position with respect to the steps of `RigidPoses.moved`.

    Args:
        points: In camera space, m.
        poses: Of the head.
        by_point: `projection_jacobian` of the points.
    """
    arms = torch.from_numpy(points - poses.translations[:, None])
    return np.concatenate((-by_point @ skew(arms).numpy(), by_point), axis=-1)


def robust_weights(
    residuals: Float[np.ndarray, "T N K"], weights: Float[np.ndarray, "T N"], scale: float
) -> Float[np.ndarray, "T N"]:
    """Weights times the Geman–McClure factor, which is 1/4 at `scale` standard deviations and falls to zero beyond.

    Args:
        residuals: Observed minus predicted: K components, such as px in x and y.
        weights: Inverse variance of each component.
        scale: In standard deviations.
    """
    squared = (residuals**2).sum(axis=-1) * weights / scale**2
    return weights / (1 + squared) ** 2


def initial_poses(
    observed: LandmarkObservations, shape: Float[np.ndarray, "N 3"], intrinsics: PinholeIntrinsics
) -> RigidPoses:
    """Perspective-n-point of every frame on the half of the landmarks with the largest weights.

    Frames without landmarks copy the nearest frame that has them.
    """
    largest = observed.weights.max(axis=0)
    rows = np.flatnonzero(largest >= np.median(largest))
    rotations, translations = np.tile(np.eye(3), (len(observed.points), 1, 1)), np.zeros((len(observed.points), 3))
    found = observed.weights.max(axis=1) > 0
    for index in np.flatnonzero(found):
        success, rotation, translation = cv2.solvePnP(
            shape[rows], observed.points[index, rows], intrinsics.matrix(), None, flags=cv2.SOLVEPNP_SQPNP
        )
        found[index] = success and translation[2, 0] > 0
        rotations[index], translations[index] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    nearest = nearest_true_index(found)
    return RigidPoses(rotations[nearest], translations[nearest])


def nearest_true_index(flags: np.ndarray) -> np.ndarray:
    """For every position the index of the nearest true flag; the earlier one of two at the same distance."""
    positions, true = np.arange(len(flags)), np.flatnonzero(flags)
    after = np.clip(np.searchsorted(true, positions), 0, len(true) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(true[before] - positions) <= np.abs(true[after] - positions)
    return np.where(closer, true[before], true[after])


def evenly_spaced(count: int, maximum: int) -> Int[np.ndarray, " K"]:
    """At most `maximum` of `count` positions, evenly spaced, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, maximum).round().astype(np.int64))


def refine_poses(
    observed: LandmarkObservations,
    shape: Float[np.ndarray, "*#T N 3"],
    intrinsics: PinholeIntrinsics,
    poses: RigidPoses,
    smoothness: float = 0.0,
    iterations: int = 8,
) -> RigidPoses:
    """Poses by Gauss–Newton on all frames at once, robust to outliers.

    Args:
        observed: Landmarks.
        shape: Head-space landmark positions, m; one set, or one per frame.
        intrinsics: Of the camera.
        poses: Initial poses.
        smoothness: Penalty on the pose's second differences relative to a typical frame's information; see
            `smoothing.penalty`. All frames are solved together, so there is no lag (as of a causal filter).
        iterations: Maximum number of Gauss–Newton steps.
    """
    for _ in range(iterations):
        steps = smooth_steps(*pose_information(observed, shape, intrinsics, poses), poses, smoothness)
        poses = poses.moved(steps)
        if np.abs(steps).max() < 1e-5:
            break
    return poses


def pose_information(
    observed: LandmarkObservations, shape: np.ndarray, intrinsics: PinholeIntrinsics, poses: RigidPoses
) -> tuple[np.ndarray, np.ndarray]:
    """Information matrix and gradient of every frame's pose from its landmarks."""
    count, shapes = len(observed.points), shape.reshape(-1, *shape.shape[-2:])
    information, gradient = np.zeros((count, POSE_SIZE, POSE_SIZE)), np.zeros((count, POSE_SIZE))
    for first in range(0, count, CHUNK):
        frames = slice(first, first + CHUNK)
        points = poses[frames].to_camera(shapes[frames] if len(shapes) > 1 else shapes)
        residuals = observed.points[frames] - project_to_pixels(points, intrinsics)
        weights = robust_weights(residuals, observed.weights[frames], 3.0)
        jacobian = pose_jacobian(points, poses[frames], projection_jacobian(points, intrinsics.focal))
        weighted = jacobian * weights[..., None, None]
        rows, weighted_rows = (part.reshape(len(points), -1, POSE_SIZE) for part in (jacobian, weighted))
        information[frames] = weighted_rows.transpose(0, 2, 1) @ rows
        gradient[frames] = np.einsum("tra,tr->ta", weighted_rows, residuals.reshape(len(points), -1))
    return information, gradient


def smooth_steps(information: np.ndarray, gradient: np.ndarray, poses: RigidPoses, smoothness: float) -> np.ndarray:
    """Gauss–Newton steps of all frames, with second differences of the moved poses penalized (a banded system)."""
    count = len(information)
    typical = _definite(np.median(information, axis=0))
    damping = 1e-6 * np.diag(np.diag(typical)) + 1e-12 * np.eye(POSE_SIZE)
    if smoothness == 0 or count < 3:
        return np.linalg.solve(information + damping, gradient[..., None])[..., 0]
    metric = smoothness * typical
    gradient = gradient - (_stencil_transpose(_accelerations(poses)) @ metric.T)
    return solve_smoothed(information + damping, gradient, metric)


def _definite(matrix: Float[np.ndarray, "N N"]) -> Float[np.ndarray, "N N"]:
    """A nearby positive definite matrix: an entrywise median of information matrices may be indefinite."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return (vectors * np.maximum(values, 1e-6)) @ vectors.T * np.outer(scale, scale)


def solve_smoothed(
    information: Float[np.ndarray, "T N N"], gradient: Float[np.ndarray, "T N"], metric: Float[np.ndarray, "N N"]
) -> Float[np.ndarray, "T N"]:
    """Least squares over all frames with second differences penalized by `metric` (a banded system)."""
    count, width = gradient.shape
    stencil = second_difference_stencil(count)
    bands = np.zeros((3 * width, count * width))
    for offset in range(3):
        blocks = stencil[offset, : count - offset, None, None] * metric
        _add_blocks(bands, blocks + information if offset == 0 else blocks, offset)
    return solveh_banded(bands, gradient.ravel(), lower=True).reshape(count, width)


def _add_blocks(bands: np.ndarray, blocks: np.ndarray, offset: int) -> None:
    """Add blocks (t + offset, t) of a symmetric matrix to lower banded storage."""
    count, width = len(blocks), blocks.shape[-1]
    for row in range(width):
        for column in range(width):
            below = offset * width + row - column
            if below >= 0:
                bands[below, np.arange(count) * width + column] += blocks[:, row, column]


def second_difference_stencil(count: int) -> Float[np.ndarray, "3 count"]:
    """Diagonal, first and second lower diagonal of DᵀD, where D takes second differences of `count` values."""
    stencil = np.zeros((3, count))
    inner = count - 2
    for shift, factor in enumerate((1.0, -2.0, 1.0)):
        stencil[0, shift : shift + inner] += factor**2
    stencil[1, :inner] += -2.0
    stencil[1, 1 : 1 + inner] += -2.0
    stencil[2, :inner] += 1.0
    return stencil


def _accelerations(poses: RigidPoses) -> np.ndarray:
    """Second differences of the poses, in rotation vectors (rad) and meters; the first and last frame have none."""
    rotations = Rotation.from_matrix(poses.rotations[1:] @ poses.rotations[:-1].transpose(0, 2, 1)).as_rotvec()
    velocities = np.concatenate((rotations, np.diff(poses.translations, axis=0)), axis=1)
    return np.diff(velocities, axis=0)


def _stencil_transpose(accelerations: np.ndarray) -> np.ndarray:
    """Dᵀ applied to second differences."""
    result = np.zeros((len(accelerations) + 2, accelerations.shape[1]))
    for shift, factor in enumerate((1.0, -2.0, 1.0)):
        result[shift : shift + len(accelerations)] += factor * accelerations
    return result
