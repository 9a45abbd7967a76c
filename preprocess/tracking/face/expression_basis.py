"""Learning a subject's expression axes from the clip's own motion, and reading the coefficients of each frame.

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
from preprocess.tracking.geometry.rigid import Lens, Observations, Poses, project, projection_slopes, robust_weights

CHUNK = 64
NAMED_SPREAD, LID_SPREAD, OWN_SPREAD, JAW_SPREAD = 0.25, 0.35, 1.0, 0.08
"""Standard deviations of coefficients about their expectation (scores; for own axes zero); jaw in rad."""
PAIRS = np.triu_indices(3)
"""Rows and columns of the upper triangle of a symmetric 3 × 3 matrix."""


@dataclass(frozen=True)
class Camera:
    """Where the clip was seen from: lens and head poses."""

    lens: Lens
    poses: Poses


def displacements(
    observed: Observations, camera: Camera, shapes: Float[np.ndarray, "*#T N 3"]
) -> Float[np.ndarray, "T N 3"]:
    """How far landmarks are from where a shape puts them, across the line of sight, m in head space.

    Zero where nothing was seen.
    """
    seen = camera.poses.to_camera(shapes.reshape(-1, *shapes.shape[-2:]))
    across = (observed.points - project(seen, camera.lens)) * (seen[..., 2:] / camera.lens.focal)
    across = np.where(observed.weights[..., None] > 0, across, 0.0)
    return np.concatenate((across, np.zeros_like(across[..., :1])), axis=-1) @ camera.poses.rotations


def regress(
    targets: Float[np.ndarray, "T N 3"], scores: Float[np.ndarray, "T S"], strength: float
) -> tuple[Float[np.ndarray, "N 3 S"], Float[np.ndarray, "N 3"]]:
    """Ridge regression of displacements on scores: slopes and intercept.

    Args:
        targets: Displacements, m.
        scores: Regressors in about [0, 1].
        strength: Ridge penalty as a variance of scores per frame; larger trusts the data less.
    """
    count = scores.shape[1]
    design = np.column_stack((scores, np.ones(len(scores))))
    normal = design.T @ design + np.diag(np.append(np.full(count, strength * len(scores)), 1e-9 * len(scores)))
    solved = np.linalg.solve(normal, design.T @ targets.reshape(len(targets), -1)).reshape(
        count + 1, *targets.shape[1:]
    )
    return np.moveaxis(solved[:count], 0, -1), solved[count]


def principal_axes(residuals: Float[np.ndarray, "T N 3"], count: int) -> tuple[Float[np.ndarray, "N 3 K"], float]:
    """The strongest directions of what is left, scaled to unit variance of their coefficients.

    And the share of energy they keep. Beyond the number of frames, axes are zero.
    """
    flat = residuals.reshape(len(residuals), -1) / np.sqrt(len(residuals))
    values, coefficients = np.linalg.eigh(flat @ flat.T)  # frames are fewer than coordinates
    axes = np.zeros((flat.shape[1], count))
    axes[:, : len(values)] = flat.T @ coefficients[:, ::-1][:, :count]
    share = float((axes**2).sum() / max(values.sum(), 1e-30))
    return axes.reshape(*residuals.shape[1:], count), share


@dataclass(frozen=True)
class Expectation:
    """What coefficients are likely before the landmarks are looked at.

    Attributes:
        coefficients: Expected value in each frame.
        spreads: Standard deviation of each coefficient about it.
        jaw: Expected turn of the jaw, rad.
        jaw_spread: Standard deviation about it, rad.
    """

    coefficients: Float[np.ndarray, "T A"]
    spreads: Float[np.ndarray, " A"]
    jaw: Float[np.ndarray, "T 2"]
    jaw_spread: float = JAW_SPREAD

    def frames(self, chosen: np.ndarray) -> Expectation:
        """Some of the frames."""
        return Expectation(self.coefficients[chosen], self.spreads, self.jaw[chosen], self.jaw_spread)


def fit_motion(
    observed: Observations, camera: Camera, model: FaceModel, expected: Expectation, iterations: int = 2
) -> FaceMotion:
    """Most likely coefficients and jaw turn of every frame given its landmarks (robust Gauss–Newton)."""
    columns = np.concatenate((model.axes, model.jaw_slopes()), axis=-1)
    products = paired_products(columns)

    def fit(first: int) -> np.ndarray:
        chosen = slice(first, first + CHUNK)
        local = Camera(camera.lens, camera.poses[chosen])
        state = mean[chosen]
        for _ in range(iterations):
            motion = FaceMotion(state[:, :-JAW_DEGREES], state[:, -JAW_DEGREES:])
            slopes, pull = _landmark_slopes(observed[chosen], local, model, motion)
            information = (slopes[..., PAIRS[0]] * slopes[..., PAIRS[1]]).sum(axis=-2).reshape(len(state), -1)
            normal = symmetric(information @ products, columns.shape[-1]) + np.diag(prior)
            gradient = pull @ columns.reshape(-1, columns.shape[-1]) + prior * (mean[chosen] - state)
            state = state + np.linalg.solve(normal, gradient[..., None])[..., 0]
        return state

    prior = np.concatenate((expected.spreads**-2, np.full(JAW_DEGREES, expected.jaw_spread**-2)))
    mean = np.concatenate((expected.coefficients, expected.jaw), axis=1)
    found = np.concatenate(list(ordered_map(fit, range(0, len(mean), CHUNK))))
    return FaceMotion(found[:, :-JAW_DEGREES], found[:, -JAW_DEGREES:])


def _landmark_slopes(
    observed: Observations, camera: Camera, model: FaceModel, motion: FaceMotion
) -> tuple[Float[np.ndarray, "T N 2 3"], Float[np.ndarray, "T K"]]:
    """How image positions change with displacements before the jaw turns them, over their standard deviations.

    And the gradient of the fit by these displacements, three numbers a landmark.
    """
    seen = camera.poses.to_camera(model.shapes(motion.coefficients, motion.jaw))
    residuals = observed.points - project(seen, camera.lens)
    deviations = np.sqrt(robust_weights(residuals, observed.weights, 3.0))[..., None]
    turned = np.einsum("tab,tnbc->tnac", camera.poses.rotations, model.blends(motion.jaw), optimize=True)
    slopes = np.einsum("tnxa,tnab->tnxb", projection_slopes(seen, camera.lens.focal), turned) * deviations[..., None]
    gradient = (slopes * (residuals * deviations)[..., None]).sum(axis=-2)
    return slopes, gradient.reshape(len(gradient), -1)


def paired_products(columns: Float[np.ndarray, "N 3 A"]) -> Float[np.ndarray, "M P"]:
    """Products of two columns each, so that Σ columnsᵀ G columns over landmarks is one matrix product.

    Rows are landmarks times `PAIRS`, columns the upper triangle of the A × A result.
    """
    first, second = np.triu_indices(columns.shape[-1])
    here, there = columns[:, PAIRS[0]], columns[:, PAIRS[1]]
    once = here[..., first] * there[..., second]
    twice = there[..., first] * here[..., second]
    return (once + (PAIRS[0] != PAIRS[1])[:, None] * twice).reshape(-1, len(first))


def symmetric(triangles: Float[np.ndarray, "T P"], size: int) -> Float[np.ndarray, "T A A"]:
    """Matrices from their upper triangles."""
    matrices = np.empty((len(triangles), size, size))
    first, second = np.triu_indices(size)
    matrices[:, first, second] = matrices[:, second, first] = triangles
    return matrices


def refine_axes(
    observed: Observations, camera: Camera, model: FaceModel, motion: FaceMotion, learned: Float[np.ndarray, " A"]
) -> FaceModel:
    """Neutral shape and axes that explain the image positions best, given poses, coefficients and jaw.

    One small system a landmark.

    Args:
        observed: Landmarks.
        camera: Lens and poses.
        model: Where to start; the solution is drawn to it, most where the clip says little (depth, rare expressions).
        motion: Of all frames.
        learned: 1 for axes that may change, 0 for those that are given (lids).
    """
    design = np.column_stack((motion.coefficients * learned, np.ones(len(motion.jaw))))
    size, count = design.shape[1], len(model.neutral)
    slopes, gradient = _landmark_slopes(observed, camera, model, motion)
    information = np.matmul(slopes.swapaxes(-1, -2), slopes).reshape(len(design), -1)
    outer = (design[:, :, None] * design[:, None]).reshape(len(design), -1)
    normal = (outer.T @ information).reshape(size, size, count, 3, 3).transpose(2, 0, 3, 1, 4)
    vector = (design.T @ gradient).reshape(size, count, 3).transpose(1, 0, 2)
    pull = np.tile([1.0, 1.0, 4.0], size) / 0.002**2
    normal = normal.reshape(count, 3 * size, 3 * size) + np.diag(pull)
    steps = np.linalg.solve(normal, vector.reshape(count, -1, 1)).reshape(count, size, 3)
    axes = model.axes + np.moveaxis(steps[:, :-1], 1, 2) * learned
    return dataclasses.replace(model, neutral=model.neutral + steps[:, -1], axes=axes)
