"""Bundle adjustment of a clip: one focal length, one mean face shape and a rigid pose per frame, estimated jointly.

A rotating head reveals its depth: one shape and one focal length explain the same face best, seen from several sides
under perspective. Two priors keep the estimate from drifting (towards a long focal length or a flat face) where the
clip constrains it weakly: the face is the canonical one plus a smooth deformation, and people are filmed from about
arm's length.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    PinholeIntrinsics,
    RigidPoses,
    pose_jacobian,
    project_to_pixels,
    projection_jacobian,
    robust_weights,
)

PRIOR_DISTANCE = 1.0
"""Prior median of the distance between camera and face, m."""
PRIOR_LOG_DISTANCE_STD = 0.2
"""Prior standard deviation of the distance's logarithm."""
DEFORMATION_STD = 0.004
"""Standard deviation of a face's smooth deformation from the canonical one, m."""
DEFORMATION_LENGTH_SCALE = 0.035
"""Length scale of the deformation's squared-exponential covariance, m."""
DEPTH_SCALE, DEPTH_SCALE_STD = 0.88, 0.05
"""Mean and standard deviation of the face's depth relative to the canonical one.

The landmark network shows about a tenth less parallax of rotated heads than there is
(docs/experiments/2026-11-22-built-in-tracker.md); a face flattened alike gives rotations their true size.
"""
MODE_COUNT = 40
"""Modes of deformation that are kept."""


@dataclass(frozen=True)
class BundleEstimate:
    """Result of the adjustment, or its initial values.

    Attributes:
        intrinsics: Of the camera.
        shape: Mean landmark positions in head space, m.
        poses: Head-to-camera, one per frame.
        log_focal_std: Posterior standard deviation of log focal length; 0 if it was held.
    """

    intrinsics: PinholeIntrinsics
    shape: Float[np.ndarray, "N 3"]
    poses: RigidPoses
    log_focal_std: float


@dataclass(frozen=True)
class ShapePrior:
    """A Gaussian process of smooth deformations, truncated to its strongest modes.

    Attributes:
        mean: Canonical landmarks, flattened by `DEPTH_SCALE`, m.
        modes: Displacement per unit of a coefficient with standard normal prior, the same for x, y and z, m.
    """

    mean: Float[np.ndarray, "N 3"]
    modes: Float[np.ndarray, "N M"]

    @staticmethod
    def from_canonical(canonical: Float[np.ndarray, "N 3"]) -> ShapePrior:
        """The prior of deformations from the canonical landmarks (m) with a squared-exponential covariance."""
        squared = ((canonical[:, None] - canonical[None]) ** 2).sum(axis=-1)
        values, vectors = np.linalg.eigh(np.exp(-squared / (2 * DEFORMATION_LENGTH_SCALE**2)))
        modes = vectors[:, ::-1][:, :MODE_COUNT] * np.sqrt(np.maximum(values[::-1][:MODE_COUNT], 0))
        depth = canonical[:, 2:] - canonical[:, 2].mean()
        flattened = canonical - (1 - DEPTH_SCALE) * depth * [0.0, 0.0, 1.0]
        return ShapePrior(flattened, np.concatenate((DEFORMATION_STD * modes, DEPTH_SCALE_STD * depth), axis=1))


def prior_focal(poses: RigidPoses, intrinsics: PinholeIntrinsics) -> float:
    """Focal length (px) that puts the face at `PRIOR_DISTANCE`, given poses found with any focal length."""
    magnification = intrinsics.focal / np.median(poses.translations[:, 2])
    return float(PRIOR_DISTANCE * magnification)


@dataclass(frozen=True)
class _State:
    focal: float
    coefficients: Float[np.ndarray, "M 3"]
    poses: RigidPoses


@dataclass(frozen=True)
class _System:
    """Normal equations with the poses eliminated, and the blocks for back-substitution."""

    matrix: np.ndarray
    vector: np.ndarray
    coupling: np.ndarray
    inverse: np.ndarray
    gradient: np.ndarray


def bundle_adjust(
    observed: LandmarkObservations,
    prior: ShapePrior,
    start: BundleEstimate,
    offsets: Float[np.ndarray, "#T N 3"] | None = None,
    hold_focal: bool = False,
    iterations: int = 40,
) -> BundleEstimate:
    """Bundle adjustment by Gauss–Newton on focal length, shape and poses.

    Poses are eliminated (Schur complement), so that the cost is linear in the number of frames.

    Args:
        observed: Landmarks and inverse variances. Errors of neighboring landmarks are correlated: give variances large
            enough that the sum over all of them is the true information.
        prior: Of the mean shape.
        start: Initial values; the focal length is also the center of its prior.
        offsets: Displacements that expressions add to the mean shape in each frame, m in head space.
        hold_focal: Keep the focal length fixed.
        iterations: Maximum number of Gauss–Newton steps.
    """
    displacements = np.zeros((1, 1, 3)) if offsets is None else offsets
    state = _State(start.intrinsics.focal, np.zeros((prior.modes.shape[1], 3)), start.poses)
    log_focal_std = 0.0
    for _ in range(iterations):
        system = _normal_equations(observed, prior, state, displacements, start.intrinsics)
        step, log_focal_std = _shared_step(system, hold_focal)
        pose_steps = np.einsum(
            "tab,tb->ta", system.inverse, system.gradient - np.einsum("tsa,s->ta", system.coupling, step)
        )
        state = _State(
            float(state.focal * np.exp(np.clip(step[-1], -0.3, 0.3))),
            state.coefficients + step[:-1].reshape(-1, 3),
            state.poses.moved(pose_steps),
        )
        if abs(step[-1]) < 1e-4 and np.abs(pose_steps).max() < 1e-4:
            break
    shape = prior.mean + prior.modes @ state.coefficients
    return BundleEstimate(dataclasses.replace(start.intrinsics, focal=state.focal), shape, state.poses, log_focal_std)


def _shared_step(system: _System, hold_focal: bool) -> tuple[np.ndarray, float]:
    """Step of shape coefficients and log focal length, and the standard deviation of the latter."""
    if hold_focal:
        step = np.append(np.linalg.solve(system.matrix[:-1, :-1], system.vector[:-1]), 0.0)
        return step, 0.0
    inverse = np.linalg.inv(system.matrix)
    return inverse @ system.vector, float(np.sqrt(inverse[-1, -1]))


def _normal_equations(
    observed: LandmarkObservations,
    prior: ShapePrior,
    state: _State,
    displacements: np.ndarray,
    start: PinholeIntrinsics,
) -> _System:
    intrinsics = dataclasses.replace(start, focal=state.focal)
    points = state.poses.to_camera(prior.mean + prior.modes @ state.coefficients + displacements)
    predicted = project_to_pixels(points, intrinsics)
    residuals = observed.points - predicted
    weights = robust_weights(residuals, observed.weights, 1.0)
    jacobian = projection_jacobian(points, intrinsics.focal)
    by_pose = pose_jacobian(points, state.poses, jacobian)
    by_point = np.einsum("tnxa,tab->tnxb", jacobian, state.poses.rotations)
    by_focal = predicted - np.asarray(intrinsics.center)
    weighted_pose, weighted_point = by_pose * weights[..., None, None], by_point * weights[..., None, None]

    pose_information = np.einsum("tnxa,tnxb->tab", weighted_pose, by_pose, optimize=True)
    pose_information += 1e-9 * np.eye(6) * np.trace(pose_information, axis1=1, axis2=2).mean()
    inverse = np.linalg.inv(pose_information)
    gradient = np.einsum("tnxa,tnx->ta", weighted_pose, residuals)
    coupling = _coupling(prior.modes, by_point, weighted_pose, by_focal)
    matrix, vector = _shared_information(prior.modes, by_point, weighted_point, by_focal, residuals, weights)
    matrix[:-1, :-1] += np.eye(len(matrix) - 1)
    vector[:-1] -= state.coefficients.ravel()
    matrix[-1, -1] += PRIOR_LOG_DISTANCE_STD**-2
    vector[-1] -= np.log(state.focal / start.focal) * PRIOR_LOG_DISTANCE_STD**-2
    eliminated = coupling @ inverse
    matrix -= np.einsum("tsa,tra->sr", eliminated, coupling, optimize=True)
    vector -= np.einsum("tsa,ta->s", eliminated, gradient)
    return _System(matrix, vector, coupling, inverse, gradient)


def _coupling(modes: np.ndarray, by_point: np.ndarray, weighted_pose: np.ndarray, by_focal: np.ndarray) -> np.ndarray:
    """Off-diagonal blocks of the normal equations: shape coefficients and log focal length (rows) by every pose."""
    blocks = np.einsum("tnxa,tnxb->tnab", by_point, weighted_pose, optimize=True)
    shape = np.einsum("nm,tnab->tmab", modes, blocks, optimize=True).reshape(len(blocks), -1, 6)
    focal = np.einsum("tnxa,tnx->ta", weighted_pose, by_focal)
    return np.concatenate((shape, focal[:, None]), axis=1)


def _shared_information(
    modes: np.ndarray,
    by_point: np.ndarray,
    weighted_point: np.ndarray,
    by_focal: np.ndarray,
    residuals: np.ndarray,
    weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Information matrix and gradient of the shape coefficients, with log focal length last."""
    count = 3 * modes.shape[1]
    per_point = np.einsum("tnxa,tnxb->nab", weighted_point, by_point, optimize=True)
    matrix = np.zeros((count + 1, count + 1))
    matrix[:-1, :-1] = np.einsum("nm,nab,nk->makb", modes, per_point, modes, optimize=True).reshape(count, count)
    mixed = modes.T @ np.einsum("tnxa,tnx->na", weighted_point, by_focal)
    matrix[-1, :-1] = matrix[:-1, -1] = mixed.ravel()
    matrix[-1, -1] = np.einsum("tn,tnx->", weights, by_focal**2)
    vector = np.append(
        (modes.T @ np.einsum("tnxa,tnx->na", weighted_point, residuals)).ravel(),
        np.einsum("tn,tnx,tnx->", weights, by_focal, residuals),
    )
    return matrix, vector
