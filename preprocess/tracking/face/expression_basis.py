"""Learns a subject's expression axes from the clip's own motion, and fits the coefficients of every frame.

Named axes start as those of a generic face and are corrected by ridge regression of the observed displacements on the
blendshape scores, so that an axis keeps its meaning and an expression the clip does not show stays generic. What the
scores cannot explain goes to axes of the subject's own, by principal components.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ggavatar.io.ordered_map import ordered_map
from preprocess.tracking.geometry.landmark_model import JAW_DEGREES, FaceModel, FaceMotion
from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    PinholeIntrinsics,
    RigidPoses,
    project_to_pixels,
    projection_jacobian,
    robust_weights,
)

CHUNK = 64
"""Frames that one thread fits at a time."""
NAMED_STD, LID_STD, PERSONAL_STD, JAW_STD = 0.25, 0.35, 1.0, 0.08
"""Prior standard deviations of coefficients about the scores (about zero for personal axes), and of the jaw, rad."""
PAIRS = np.triu_indices(3)
"""Rows and columns of the upper triangle of a symmetric 3 × 3 matrix."""


@dataclass(frozen=True)
class PosedCamera:
    """Intrinsics, and the head's pose in the camera in every frame."""

    intrinsics: PinholeIntrinsics
    poses: RigidPoses


def landmark_displacements(
    observed: LandmarkObservations, camera: PosedCamera, shapes: Float[np.ndarray, "*#T N 3"]
) -> Float[np.ndarray, "T N 3"]:
    """Displacements of observed landmarks from shapes across the line of sight, m in head space.

    They are zero where the weight is zero.
    """
    points = camera.poses.to_camera(shapes.reshape(-1, *shapes.shape[-2:]))
    residuals = observed.points - project_to_pixels(points, camera.intrinsics)
    across = residuals * (points[..., 2:] / camera.intrinsics.focal)
    across = np.where(observed.weights[..., None] > 0, across, 0.0)
    return np.concatenate((across, np.zeros_like(across[..., :1])), axis=-1) @ camera.poses.rotations


def ridge_regression(
    targets: Float[np.ndarray, "T N 3"], scores: Float[np.ndarray, "T S"], strength: float
) -> tuple[Float[np.ndarray, "N 3 S"], Float[np.ndarray, "N 3"]]:
    """Ridge regression of displacements on scores: slopes and intercept.

    Args:
        targets: Displacements, m.
        scores: Regressors, roughly in [0, 1].
        strength: Ridge penalty per frame, in units of the scores' variance.
    """
    count = scores.shape[1]
    design = np.column_stack((scores, np.ones(len(scores))))
    normal = design.T @ design + np.diag(np.append(np.full(count, strength * len(scores)), 1e-9 * len(scores)))
    solved = np.linalg.solve(normal, design.T @ targets.reshape(len(targets), -1)).reshape(
        count + 1, *targets.shape[1:]
    )
    return np.moveaxis(solved[:count], 0, -1), solved[count]


def principal_axes(residuals: Float[np.ndarray, "T N 3"], count: int) -> tuple[Float[np.ndarray, "N 3 K"], float]:
    """Principal components scaled to unit variance of their coefficients, and the share of energy they explain.

    Axes beyond the number of frames are zero.
    """
    flat = residuals.reshape(len(residuals), -1) / np.sqrt(len(residuals))
    values, coefficients = np.linalg.eigh(flat @ flat.T)  # frames are fewer than coordinates
    axes = np.zeros((flat.shape[1], count))
    axes[:, : len(values)] = flat.T @ coefficients[:, ::-1][:, :count]
    share = float((axes**2).sum() / max(values.sum(), 1e-30))
    return axes.reshape(*residuals.shape[1:], count), share


@dataclass(frozen=True)
class MotionPrior:
    """Gaussian prior of a `FaceMotion`.

    Attributes:
        coefficients: Mean in each frame.
        stds: Standard deviation of each coefficient.
        jaw: Mean rotation of the jaw in each frame, rad.
        jaw_std: Standard deviation of the jaw's rotation, rad.
    """

    coefficients: Float[np.ndarray, "T A"]
    stds: Float[np.ndarray, " A"]
    jaw: Float[np.ndarray, "T 2"]
    jaw_std: float = JAW_STD

    def frames(self, chosen: np.ndarray) -> MotionPrior:
        """The prior of some of the frames."""
        return MotionPrior(self.coefficients[chosen], self.stds, self.jaw[chosen], self.jaw_std)


def fit_motion(
    observed: LandmarkObservations, camera: PosedCamera, model: FaceModel, prior: MotionPrior, iterations: int = 2
) -> FaceMotion:
    """Maximum a posteriori coefficients and jaw rotation of every frame (robust Gauss–Newton)."""
    columns = np.concatenate((model.axes, model.jaw_jacobian()), axis=-1)
    products = column_products(columns)

    def fit(first: int) -> np.ndarray:
        chosen = slice(first, first + CHUNK)
        local = PosedCamera(camera.intrinsics, camera.poses[chosen])
        state = mean[chosen]
        for _ in range(iterations):
            motion = FaceMotion(state[:, :-JAW_DEGREES], state[:, -JAW_DEGREES:])
            jacobian, by_point = _whitened_jacobian(observed[chosen], local, model, motion)
            information = (jacobian[..., PAIRS[0]] * jacobian[..., PAIRS[1]]).sum(axis=-2).reshape(len(state), -1)
            normal = symmetric_from_upper(information @ products, columns.shape[-1]) + np.diag(precision)
            gradient = by_point @ columns.reshape(-1, columns.shape[-1]) + precision * (mean[chosen] - state)
            state = state + np.linalg.solve(normal, gradient[..., None])[..., 0]
        return state

    precision = np.concatenate((prior.stds**-2, np.full(JAW_DEGREES, prior.jaw_std**-2)))
    mean = np.concatenate((prior.coefficients, prior.jaw), axis=1)
    states = np.concatenate(list(ordered_map(fit, range(0, len(mean), CHUNK))))
    return FaceMotion(states[:, :-JAW_DEGREES], states[:, -JAW_DEGREES:])


def _whitened_jacobian(
    observed: LandmarkObservations, camera: PosedCamera, model: FaceModel, motion: FaceMotion
) -> tuple[Float[np.ndarray, "T N 2 3"], Float[np.ndarray, "T K"]]:
    """Jacobian of image positions by displacements before the jaw rotates them, times root weights; and the gradient.

    The gradient of the fit has three components per landmark.
    """
    points = camera.poses.to_camera(model.shapes(motion.coefficients, motion.jaw))
    residuals = observed.points - project_to_pixels(points, camera.intrinsics)
    root_weights = np.sqrt(robust_weights(residuals, observed.weights, 3.0))[..., None]
    linear = np.einsum("tab,tnbc->tnac", camera.poses.rotations, model.blend_matrices(motion.jaw), optimize=True)
    by_point = projection_jacobian(points, camera.intrinsics.focal)
    jacobian = np.einsum("tnxa,tnab->tnxb", by_point, linear) * root_weights[..., None]
    gradient = (jacobian * (residuals * root_weights)[..., None]).sum(axis=-2)
    return jacobian, gradient.reshape(len(gradient), -1)


def column_products(columns: Float[np.ndarray, "N 3 A"]) -> Float[np.ndarray, "M P"]:
    """Pairwise products of columns, with which Σ columnsᵀ G columns over all landmarks is one matrix product.

    Rows are landmarks times `PAIRS`, columns the upper triangle of the A × A result.
    """
    first, second = np.triu_indices(columns.shape[-1])
    here, there = columns[:, PAIRS[0]], columns[:, PAIRS[1]]
    once = here[..., first] * there[..., second]
    twice = there[..., first] * here[..., second]
    return (once + (PAIRS[0] != PAIRS[1])[:, None] * twice).reshape(-1, len(first))


def symmetric_from_upper(triangles: Float[np.ndarray, "T P"], size: int) -> Float[np.ndarray, "T A A"]:
    """Symmetric matrices from their upper triangles."""
    matrices = np.empty((len(triangles), size, size))
    first, second = np.triu_indices(size)
    matrices[:, first, second] = matrices[:, second, first] = triangles
    return matrices


def refine_axes(
    observed: LandmarkObservations,
    camera: PosedCamera,
    model: FaceModel,
    motion: FaceMotion,
    learned: Float[np.ndarray, " A"],
) -> FaceModel:
    """Neutral shape and axes that fit the image positions best, given poses, coefficients and jaw.

    There is one small linear system per landmark.

    Args:
        observed: Landmarks.
        camera: Intrinsics and poses.
        model: Initial model; it is also the prior, which dominates where the clip constrains little (depth, rare
            expressions).
        motion: Of all frames.
        learned: 1 for axes that may change, 0 for those that are fixed (lids).
    """
    design = np.column_stack((motion.coefficients * learned, np.ones(len(motion.jaw))))
    size, count = design.shape[1], len(model.neutral)
    jacobian, gradient = _whitened_jacobian(observed, camera, model, motion)
    information = np.matmul(jacobian.swapaxes(-1, -2), jacobian).reshape(len(design), -1)
    outer = (design[:, :, None] * design[:, None]).reshape(len(design), -1)
    normal = (outer.T @ information).reshape(size, size, count, 3, 3).transpose(2, 0, 3, 1, 4)
    vector = (design.T @ gradient).reshape(size, count, 3).transpose(1, 0, 2)
    precision = np.tile([1.0, 1.0, 4.0], size) / 0.002**2
    normal = normal.reshape(count, 3 * size, 3 * size) + np.diag(precision)
    steps = np.linalg.solve(normal, vector.reshape(count, -1, 1)).reshape(count, size, 3)
    axes = model.axes + np.moveaxis(steps[:, :-1], 1, 2) * learned
    return dataclasses.replace(model, neutral=model.neutral + steps[:, -1], axes=axes)
