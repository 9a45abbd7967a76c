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

from preprocess.face_model import JAW_DEGREES, FaceModel, FaceMotion
from preprocess.in_order import in_order
from preprocess.rigid import Lens, Observations, Poses, project, projection_slopes, robust_weights

CHUNK = 64
NAMED_SPREAD, LID_SPREAD, OWN_SPREAD, JAW_SPREAD = 0.25, 0.35, 1.0, 0.08
"""Standard deviations of coefficients about their expectation (scores; for own axes zero); jaw in rad."""


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

    And the share of energy they keep.
    """
    flat = residuals.reshape(len(residuals), -1)
    values, vectors = np.linalg.eigh(flat.T @ flat / len(flat))
    count = min(count, len(values))
    kept = np.maximum(values[::-1][:count], 0)
    axes = vectors[:, ::-1][:, :count] * np.sqrt(kept)
    share = float(kept.sum() / max(values.sum(), 1e-30))
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

    def frames(self, chosen: slice | np.ndarray) -> Expectation:
        """Some of the frames."""
        return Expectation(self.coefficients[chosen], self.spreads, self.jaw[chosen], self.jaw_spread)


def fit_motion(
    observed: Observations, camera: Camera, model: FaceModel, expected: Expectation, iterations: int = 2
) -> FaceMotion:
    """Most likely coefficients and jaw turn of every frame given its landmarks (Gauss–Newton, robust.

    Frame by frame).
    """

    def fit(first: int) -> FaceMotion:
        chosen = slice(first, first + CHUNK)
        local = Camera(camera.lens, camera.poses[chosen])
        return _fit_chunk(observed[chosen], local, model, expected.frames(chosen), iterations)

    parts = list(in_order(fit, range(0, len(observed.points), CHUNK)))
    return FaceMotion(
        np.concatenate([part.coefficients for part in parts]), np.concatenate([part.jaw for part in parts])
    )


def _fit_chunk(
    observed: Observations, camera: Camera, model: FaceModel, expected: Expectation, iterations: int
) -> FaceMotion:
    prior = np.concatenate((expected.spreads**-2, np.full(JAW_DEGREES, expected.jaw_spread**-2)))
    mean = np.concatenate((expected.coefficients, expected.jaw), axis=1)
    state = mean.copy()
    for _ in range(iterations):
        coefficients, jaw = state[:, :-JAW_DEGREES], state[:, -JAW_DEGREES:]
        seen = camera.poses.to_camera(model.shapes(coefficients, jaw))
        residuals = observed.points - project(seen, camera.lens)
        weights = robust_weights(residuals, observed.weights, 3.0)
        slopes = np.einsum("tnxa,tab->tnxb", projection_slopes(seen, camera.lens.focal), camera.poses.rotations)
        by_axis = np.matmul(np.matmul(slopes, model.blends(jaw)), model.axes)
        jacobian = np.concatenate((by_axis, np.matmul(slopes, model.jaw_slopes())), axis=-1)
        jacobian, residuals = jacobian * np.sqrt(weights)[..., None, None], residuals * np.sqrt(weights)[..., None]
        rows = jacobian.reshape(len(jacobian), -1, jacobian.shape[-1])
        normal = rows.transpose(0, 2, 1) @ rows + np.diag(prior)
        gradient = np.einsum("tra,tr->ta", rows, residuals.reshape(len(rows), -1)) + prior * (mean - state)
        state = state + np.linalg.solve(normal, gradient[..., None])[..., 0]
    return FaceMotion(state[:, :-JAW_DEGREES], state[:, -JAW_DEGREES:])


def refine_axes(
    observed: Observations, camera: Camera, model: FaceModel, motion: FaceMotion, learned: Float[np.ndarray, " A"]
) -> FaceModel:
    """Neutral shape and axes that explain the image positions best, given poses.

    Coefficients and jaw (one small system a landmark).

    Args:
        observed: Landmarks.
        camera: Lens and poses.
        model: Where to start; the solution is drawn to it, most where the clip says little (depth, rare expressions).
        motion: Of all frames.
        learned: 1 for axes that may change, 0 for those that are given (lids).
    """
    shapes = model.shapes(motion.coefficients, motion.jaw)
    design = np.column_stack((motion.coefficients * learned, np.ones(len(motion.jaw))))
    size = design.shape[1]
    normal = np.zeros((len(model.neutral), size * 3, size * 3))
    vector = np.zeros((len(model.neutral), size * 3))
    for first in range(0, len(design), CHUNK):
        chosen = slice(first, first + CHUNK)
        poses, used = camera.poses[chosen], design[chosen]
        seen = poses.to_camera(shapes[chosen])
        residuals = observed.points[chosen] - project(seen, camera.lens)
        weights = robust_weights(residuals, observed.weights[chosen], 3.0)
        slopes = np.einsum("tnxa,tab->tnxb", projection_slopes(seen, camera.lens.focal), poses.rotations)
        slopes = np.matmul(slopes, model.blends(motion.jaw[chosen])) * np.sqrt(weights)[..., None, None]
        rows = np.einsum("ts,tnxa->ntxsa", used, slopes, optimize=True).reshape(len(normal), -1, size * 3)
        normal += rows.transpose(0, 2, 1) @ rows
        flat = (residuals * np.sqrt(weights)[..., None]).transpose(1, 0, 2).reshape(len(normal), -1, 1)
        vector += (rows.transpose(0, 2, 1) @ flat)[..., 0]
    pull = np.tile([1.0, 1.0, 4.0], size) / 0.002**2
    steps = np.linalg.solve(normal + np.diag(pull), vector[..., None])[..., 0].reshape(len(normal), size, 3)
    axes = model.axes + np.moveaxis(steps[:, :-1], 1, 2) * learned
    return dataclasses.replace(model, neutral=model.neutral + steps[:, -1], axes=axes)
