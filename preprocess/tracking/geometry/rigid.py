"""Rigid head poses from landmarks of a known, possibly moving shape: start, robust refinement.

Smoothing over time. Plain numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

POSE = 6
CHUNK = 256


@dataclass(frozen=True)
class Lens:
    """A pinhole camera without distortion and with square pixels.

    Attributes:
        focal: Focal length, px.
        center: Principal point, px.
    """

    focal: float
    center: tuple[float, float]

    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """Intrinsics, px."""
        return np.array([[self.focal, 0, self.center[0]], [0, self.focal, self.center[1]], [0, 0, 1.0]])


@dataclass(frozen=True)
class Poses:
    """Rigid head-to-camera transforms: x ↦ rotation x + translation.

    Attributes:
        rotations: Head axes in camera axes.
        translations: Head origin in the camera, m.
    """

    rotations: Float[np.ndarray, "T 3 3"]
    translations: Float[np.ndarray, "T 3"]

    def __getitem__(self, frames: slice | np.ndarray) -> Poses:
        return Poses(self.rotations[frames], self.translations[frames])

    def to_camera(self, points: Float[np.ndarray, "#T N 3"]) -> Float[np.ndarray, "T N 3"]:
        """Head-space points in camera metres."""
        return points @ self.rotations.transpose(0, 2, 1) + self.translations[:, None]

    def moved(self, steps: Float[np.ndarray, "T 6"]) -> Poses:
        """Turned by small rotations in camera axes (rad) and shifted (m)."""
        turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        return Poses(turns @ self.rotations, self.translations + steps[:, 3:])

    def matrices(self) -> Float[np.ndarray, "T 4 4"]:
        """As rigid 4 × 4 matrices."""
        matrices = np.tile(np.eye(4), (len(self.rotations), 1, 1))
        matrices[:, :3, :3] = self.rotations
        matrices[:, :3, 3] = self.translations
        return matrices


@dataclass(frozen=True)
class Observations:
    """Landmarks of a clip.

    Attributes:
        points: Image positions, px; finite even where nothing was seen.
        weights: Inverse variance of each point, 1/px²; zero where nothing was seen.
    """

    points: Float[np.ndarray, "T N 2"]
    weights: Float[np.ndarray, "T N"]

    def __getitem__(self, frames: slice | np.ndarray) -> Observations:
        return Observations(self.points[frames], self.weights[frames])


def project(seen: Float[np.ndarray, "T N 3"], lens: Lens) -> Float[np.ndarray, "T N 2"]:
    """Image positions of camera-space points, px."""
    return lens.focal * seen[..., :2] / seen[..., 2:] + np.asarray(lens.center)


def projection_slopes(seen: Float[np.ndarray, "T N 3"], focal: float) -> Float[np.ndarray, "T N 2 3"]:
    """Derivative of the image position by the camera-space point, px/m."""
    slopes = np.zeros((*seen.shape[:2], 2, 3))
    inverse = focal / seen[..., 2]
    slopes[..., 0, 0] = slopes[..., 1, 1] = inverse
    slopes[..., :, 2] = -inverse[..., None] * seen[..., :2] / seen[..., 2:]
    return slopes


def cross_matrices(vectors: Float[np.ndarray, "*B 3"]) -> Float[np.ndarray, "*B 3 3"]:
    """Matrices that multiply like the cross product with `vectors`."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1).reshape(*vectors.shape, 3)


def pose_slopes(
    seen: Float[np.ndarray, "T N 3"], poses: Poses, slopes: Float[np.ndarray, "T N 2 3"]
) -> Float[np.ndarray, "T N 2 6"]:
    """Derivative of the image position by the steps of `Poses.moved`."""
    arms = seen - poses.translations[:, None]
    return np.concatenate((-slopes @ cross_matrices(arms), slopes), axis=-1)


def robust_weights(
    residuals: Float[np.ndarray, "T N K"], weights: Float[np.ndarray, "T N"], scale: float
) -> Float[np.ndarray, "T N"]:
    """Weights times the Geman–McClure factor: a point off by `scale` standard deviations counts a quarter.

    Far ones hardly at all.

    Args:
        residuals: Observed minus predicted: K numbers, such as px in both directions.
        weights: Inverse variances of each.
        scale: In standard deviations.
    """
    squared = (residuals**2).sum(axis=-1) * weights / scale**2
    return weights / (1 + squared) ** 2


def initial_poses(observed: Observations, shape: Float[np.ndarray, "N 3"], lens: Lens) -> Poses:
    """Perspective-n-point of every frame on the more trusted half of the landmarks.

    Frames without any repeat their neighbour.
    """
    trusted = observed.weights.max(axis=0)
    rows = np.flatnonzero(trusted >= np.median(trusted))
    rotations, translations = np.tile(np.eye(3), (len(observed.points), 1, 1)), np.zeros((len(observed.points), 3))
    seen = observed.weights.max(axis=1) > 0
    for index in np.flatnonzero(seen):
        good, turn, shift = cv2.solvePnP(
            shape[rows], observed.points[index, rows], lens.matrix(), None, flags=cv2.SOLVEPNP_SQPNP
        )
        seen[index] = good and shift[2, 0] > 0
        rotations[index], translations[index] = cv2.Rodrigues(turn)[0], shift[:, 0]
    nearest = nearest_true(seen)
    return Poses(rotations[nearest], translations[nearest])


def nearest_true(flags: np.ndarray) -> np.ndarray:
    """For every position the index of the nearest true one."""
    positions, true = np.arange(len(flags)), np.flatnonzero(flags)
    after = np.clip(np.searchsorted(true, positions), 0, len(true) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(true[before] - positions) <= np.abs(true[after] - positions)
    return np.where(closer, true[before], true[after])


def spread_evenly(count: int, most: int) -> Int[np.ndarray, " K"]:
    """At most so many of `count` positions, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.int64))


def refine_poses(
    observed: Observations,
    shape: Float[np.ndarray, "*#T N 3"],
    lens: Lens,
    poses: Poses,
    smoothness: float = 0.0,
    iterations: int = 8,
) -> Poses:
    """Gauss–Newton on all frames at once, robust to outliers.

    Args:
        observed: Landmarks.
        shape: Head-space landmark positions, m; one set, or one a frame.
        lens: Camera.
        poses: Where to start.
        smoothness: Penalty on the pose's second differences relative to a typical frame's information; see
            `smoothing.penalty`. The solution is that of all frames together, so it is not delayed (as a filter over
            past frames would be).
        iterations: At most this many.
    """
    for _ in range(iterations):
        steps = smooth_steps(*pose_information(observed, shape, lens, poses), poses, smoothness)
        poses = poses.moved(steps)
        if np.abs(steps).max() < 1e-5:
            break
    return poses


def pose_information(
    observed: Observations, shape: np.ndarray, lens: Lens, poses: Poses
) -> tuple[np.ndarray, np.ndarray]:
    """Information matrix and gradient of every frame's pose, a part of the clip at a time to bound memory."""
    count, shapes = len(observed.points), shape.reshape(-1, *shape.shape[-2:])
    information, gradient = np.zeros((count, POSE, POSE)), np.zeros((count, POSE))
    for first in range(0, count, CHUNK):
        chosen = slice(first, first + CHUNK)
        here = poses[chosen]
        seen = here.to_camera(shapes[chosen] if len(shapes) > 1 else shapes)
        residuals = observed.points[chosen] - project(seen, lens)
        weights = robust_weights(residuals, observed.weights[chosen], 3.0)
        jacobian = pose_slopes(seen, here, projection_slopes(seen, lens.focal))
        weighted = jacobian * weights[..., None, None]
        rows, weighted_rows = (part.reshape(len(seen), -1, POSE) for part in (jacobian, weighted))
        information[chosen] = weighted_rows.transpose(0, 2, 1) @ rows
        gradient[chosen] = np.einsum("tra,tr->ta", weighted_rows, residuals.reshape(len(seen), -1))
    return information, gradient


def smooth_steps(information: np.ndarray, gradient: np.ndarray, poses: Poses, smoothness: float) -> np.ndarray:
    """Solve for the steps of all frames, with second differences of the moved poses penalised (a banded system)."""
    count = len(information)
    typical = _definite(np.median(information, axis=0))
    damping = 1e-6 * np.diag(np.diag(typical)) + 1e-12 * np.eye(POSE)
    if smoothness == 0 or count < 3:
        return np.linalg.solve(information + damping, gradient[..., None])[..., 0]
    metric = smoothness * typical
    gradient = gradient - (_stencil_transpose(_accelerations(poses)) @ metric.T)
    return solve_smooth(information + damping, gradient, metric)


def _definite(matrix: Float[np.ndarray, "N N"]) -> Float[np.ndarray, "N N"]:
    """The nearest matrix that can be a metric: a median taken entry by entry need not be positive definite."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return (vectors * np.maximum(values, 1e-6)) @ vectors.T * np.outer(scale, scale)


def solve_smooth(
    information: Float[np.ndarray, "T N N"], gradient: Float[np.ndarray, "T N"], metric: Float[np.ndarray, "N N"]
) -> Float[np.ndarray, "T N"]:
    """Least squares over all frames with second differences penalised by `metric` (a banded system)."""
    count, width = gradient.shape
    stencil = second_difference_stencil(count)
    bands = np.zeros((3 * width, count * width))
    for offset in range(3):
        blocks = stencil[offset, : count - offset, None, None] * metric
        _add_blocks(bands, blocks + information if offset == 0 else blocks, offset)
    return solveh_banded(bands, gradient.ravel(), lower=True).reshape(count, width)


def _add_blocks(bands: np.ndarray, blocks: np.ndarray, offset: int) -> None:
    """Put blocks (t + offset, t) of a symmetric matrix into lower banded storage."""
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


def _accelerations(poses: Poses) -> np.ndarray:
    """Second differences of the poses, in rotation vectors (rad) and metres, one fewer at either end."""
    turns = Rotation.from_matrix(poses.rotations[1:] @ poses.rotations[:-1].transpose(0, 2, 1)).as_rotvec()
    velocities = np.concatenate((turns, np.diff(poses.translations, axis=0)), axis=1)
    return np.diff(velocities, axis=0)


def _stencil_transpose(accelerations: np.ndarray) -> np.ndarray:
    """Dᵀ applied to second differences."""
    result = np.zeros((len(accelerations) + 2, accelerations.shape[1]))
    for shift, factor in enumerate((1.0, -2.0, 1.0)):
        result[shift : shift + len(accelerations)] += factor * accelerations
    return result
