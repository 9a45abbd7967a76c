"""Bundle adjustment of a clip: one focal length, one mean face and a rigid pose a frame, found together.

A moving head shows its own depth: the same face seen from several sides, under perspective, has one shape and one
focal length that explain it best. Two priors keep weak evidence from running away (towards a long lens, or a flat
face): the face is the canonical one plus a smooth deformation, and people are filmed from about arm's length.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import (
    Lens,
    Observations,
    Poses,
    pose_slopes,
    project,
    projection_slopes,
    robust_weights,
)

TYPICAL_DISTANCE = 1.0
"""Median distance of the prior between camera and face, m."""
DISTANCE_SPREAD = 0.2
"""Standard deviation of its logarithm."""
DEFORMATION = 0.004
"""Standard deviation of a face's smooth deformation from the canonical one, m."""
DEFORMATION_REACH = 0.035
"""Distance over which the deformation varies, m."""
DEPTH, DEPTH_SPREAD = 0.88, 0.05
"""Mean and standard deviation of the face's depth against the canonical one.

The landmark network shows turned heads with about a tenth less parallax than they have
(docs/experiments/2026-11-22-built-in-tracker.md); a face as flat as its landmarks gives head turns their true size.
"""
MODES = 40


@dataclass(frozen=True)
class Adjusted:
    """What the adjustment found.

    Attributes:
        lens: Camera.
        shape: Mean landmark positions in head space, m.
        poses: Of the frames given.
        focal_spread: Standard deviation of log focal length as the data and the prior leave it; 0 if it was held.
    """

    lens: Lens
    shape: Float[np.ndarray, "N 3"]
    poses: Poses
    focal_spread: float


@dataclass(frozen=True)
class ShapePrior:
    """A Gaussian process of smooth deformations, cut to its strongest modes.

    Attributes:
        mean: Canonical landmarks, m.
        modes: Displacement per unit of a coefficient with standard normal prior, the same for x, y and z, m.
    """

    mean: Float[np.ndarray, "N 3"]
    modes: Float[np.ndarray, "N M"]

    @staticmethod
    def around(canonical: Float[np.ndarray, "N 3"]) -> ShapePrior:
        """Deformations with `DEFORMATION` and `DEFORMATION_REACH` of a squared-exponential covariance."""
        squared = ((canonical[:, None] - canonical[None]) ** 2).sum(axis=-1)
        values, vectors = np.linalg.eigh(np.exp(-squared / (2 * DEFORMATION_REACH**2)))
        modes = vectors[:, ::-1][:, :MODES] * np.sqrt(np.maximum(values[::-1][:MODES], 0))
        depth = canonical[:, 2:] - canonical[:, 2].mean()
        flattened = canonical - (1 - DEPTH) * depth * [0.0, 0.0, 1.0]
        return ShapePrior(flattened, np.concatenate((DEFORMATION * modes, DEPTH_SPREAD * depth), axis=1))


def prior_focal(poses: Poses, lens: Lens) -> float:
    """Focal length that puts the face at the typical distance, given poses found with any focal length, px."""
    magnification = lens.focal / np.median(poses.translations[:, 2])
    return float(TYPICAL_DISTANCE * magnification)


@dataclass(frozen=True)
class _State:
    focal: float
    coefficients: Float[np.ndarray, "M 3"]
    poses: Poses


@dataclass(frozen=True)
class _System:
    """Normal equations with the poses already eliminated, and what is needed to get them back."""

    matrix: np.ndarray
    vector: np.ndarray
    coupling: np.ndarray
    inverse: np.ndarray
    gradient: np.ndarray


def adjust(
    observed: Observations,
    prior: ShapePrior,
    start: Adjusted,
    offsets: Float[np.ndarray, "#T N 3"] | None = None,
    hold_focal: bool = False,
    iterations: int = 40,
) -> Adjusted:
    """Gauss–Newton on focal length, shape and poses; poses are eliminated (Schur complement).

    So that cost is linear in frames.

    Args:
        observed: Landmarks and inverse variances. Neighbouring landmarks share their errors: give variances large
            enough that the sum over all of them is the true information.
        prior: Of the mean shape.
        start: Where to start; its focal length is also the centre of the focal prior.
        offsets: What expressions add to the mean shape in each frame, m in head space.
        hold_focal: Keep the focal length as it is.
        iterations: At most this many.
    """
    added = np.zeros((1, 1, 3)) if offsets is None else offsets
    state = _State(start.lens.focal, np.zeros((prior.modes.shape[1], 3)), start.poses)
    spread = 0.0
    for _ in range(iterations):
        system = _normal_equations(observed, prior, state, added, start.lens)
        step, spread = _shared_step(system, hold_focal)
        moves = np.einsum("tab,tb->ta", system.inverse, system.gradient - np.einsum("tsa,s->ta", system.coupling, step))
        state = _State(
            float(state.focal * np.exp(np.clip(step[-1], -0.3, 0.3))),
            state.coefficients + step[:-1].reshape(-1, 3),
            state.poses.moved(moves),
        )
        if abs(step[-1]) < 1e-4 and np.abs(moves).max() < 1e-4:
            break
    shape = prior.mean + prior.modes @ state.coefficients
    return Adjusted(dataclasses.replace(start.lens, focal=state.focal), shape, state.poses, spread)


def _shared_step(system: _System, hold_focal: bool) -> tuple[np.ndarray, float]:
    """Step of shape coefficients and log focal length, and the latter's standard deviation."""
    if hold_focal:
        step = np.append(np.linalg.solve(system.matrix[:-1, :-1], system.vector[:-1]), 0.0)
        return step, 0.0
    inverse = np.linalg.inv(system.matrix)
    return inverse @ system.vector, float(np.sqrt(inverse[-1, -1]))


def _normal_equations(
    observed: Observations, prior: ShapePrior, state: _State, added: np.ndarray, start: Lens
) -> _System:
    lens = dataclasses.replace(start, focal=state.focal)
    seen = state.poses.to_camera(prior.mean + prior.modes @ state.coefficients + added)
    predicted = project(seen, lens)
    residuals = observed.points - predicted
    weights = robust_weights(residuals, observed.weights, 1.0)
    slopes = projection_slopes(seen, lens.focal)
    by_pose = pose_slopes(seen, state.poses, slopes)
    by_point = np.einsum("tnxa,tab->tnxb", slopes, state.poses.rotations)
    by_focal = predicted - np.asarray(lens.center)
    weighted_pose, weighted_point = by_pose * weights[..., None, None], by_point * weights[..., None, None]

    pose_information = np.einsum("tnxa,tnxb->tab", weighted_pose, by_pose, optimize=True)
    pose_information += 1e-9 * np.eye(6) * np.trace(pose_information, axis1=1, axis2=2).mean()
    inverse = np.linalg.inv(pose_information)
    gradient = np.einsum("tnxa,tnx->ta", weighted_pose, residuals)
    coupling = _coupling(prior.modes, by_point, weighted_pose, by_focal)
    matrix, vector = _shared_information(prior.modes, by_point, weighted_point, by_focal, residuals, weights)
    matrix[:-1, :-1] += np.eye(len(matrix) - 1)
    vector[:-1] -= state.coefficients.ravel()
    matrix[-1, -1] += DISTANCE_SPREAD**-2
    vector[-1] -= np.log(state.focal / start.focal) * DISTANCE_SPREAD**-2
    carried = coupling @ inverse
    matrix -= np.einsum("tsa,tra->sr", carried, coupling, optimize=True)
    vector -= np.einsum("tsa,ta->s", carried, gradient)
    return _System(matrix, vector, coupling, inverse, gradient)


def _coupling(modes: np.ndarray, by_point: np.ndarray, weighted_pose: np.ndarray, by_focal: np.ndarray) -> np.ndarray:
    """Mixed second derivatives of shape coefficients and log focal length (rows) with every pose."""
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
    """Information and gradient of the shape coefficients and, last, of log focal length."""
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
