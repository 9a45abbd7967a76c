"""Motion of the shoulders' outline in the image; corrects the texture's motion and replaces it on plain clothes.

The mask's outline below the chin measures how the shoulders move across it. The motion of the texture is the starting
point and the prior for what the outline does not constrain (straight shoulders hardly distinguish size from height).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import robust_weights, solve_smoothed
from preprocess.tracking.geometry.smoothing import penalty
from preprocess.tracking.pose.outline_cue import DISTANCE_STEPS, OutlineDistances, sample_distances

SCALE_STD = 0.01
"""Prior standard deviation of the torso's relative size; the size that the texture measures is worse than none."""
CUTOFF = 2.5
"""Fastest motion that is kept where the outline constrains it well, Hz."""
TEXTURE_STD, REST_STD = 0.015, 0.06
"""Standard deviations of the texture's motion, and of rest where there is none, over the face's height."""
OUTLINE_STD = 0.004
"""Standard deviation of the outline's position without its constant part, over the face's height."""
EFFECTIVE_OUTLINE_POINTS = 8.0
"""Effective number of independent points on the whole outline."""
MINIMUM_OUTLINE_POINTS = 12
"""With fewer points of the mean outline it is not used."""
MAXIMUM_FRAMES, MAXIMUM_POINTS = 200, 100
"""Limits on the frames from which the mean outline is found, and on its points."""
CHIN_MARGIN = 0.05
"""How far below the chin the torso begins, over the face's height."""
ROBUST_SCALES = (8.0, 4.0, 2.0, 1.0, 1.0)
"""Factors on the scale of the robust weights in each iteration, from coarse to fine."""
QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Rotates row vectors by 90°: the derivative of a point's position with respect to roll."""


def outline_motions(
    motions: Sequence[Float[np.ndarray, "3 3"] | None],
    outline: OutlineDistances,
    faces: Float[np.ndarray, "T 2"],
    fps: float,
) -> list[np.ndarray | None]:
    """Similarities of the shoulders' outline from the first frame's pixels to each frame's.

    Args:
        motions: Of the texture; None where it was not tracked.
        outline: Of the masks.
        faces: Top and bottom row of every face, px.
        fps: Frames per second.

    Returns:
        As `motions`, which are returned unchanged if there is no outline below the chin.
    """
    tracked = np.array([motion is not None for motion in motions])
    start = np.stack([np.eye(3) if motion is None else motion for motion in motions])
    height = float(np.median(faces[:, 1] - faces[:, 0]))
    points, normals = _mean_outline(outline, float(np.median(faces[:, 1])) + CHIN_MARGIN * height)
    if len(points) < MINIMUM_OUTLINE_POINTS:
        return list(motions)
    typical = start[np.argmin(np.abs(start[:, :2, 2] - np.median(start[:, :2, 2], axis=0)).sum(axis=1))]
    deviations = np.where(tracked, TEXTURE_STD, REST_STD) * height
    relative = _without_scale(start @ np.linalg.inv(typical), points.mean(axis=0))
    smoothness = penalty(CUTOFF, fps) if len(start) > 2 else 0.0
    corrections = _corrections(relative, points, normals, outline, deviations, OUTLINE_STD * height, smoothness)
    return list(corrections @ relative @ typical)


def _mean_outline(outline: OutlineDistances, top: float) -> tuple[Float[np.ndarray, "P 2"], Float[np.ndarray, "P 2"]]:
    """Points of the median outline below row `top`, px, and their unit normals into the torso.

    Points are pixels whose median distance over the clip is less than one; the image's border is left out.
    """
    step = -(-len(outline.distances) // MAXIMUM_FRAMES)
    distances = np.median(outline.distances[::step], axis=0).astype(np.float64)
    down, across = np.gradient(cv2.GaussianBlur(distances, (0, 0), 1.0))
    slope = np.hypot(across, down)
    near = (np.abs(distances) < DISTANCE_STEPS) & (slope > 0.5 * DISTANCE_STEPS)
    near[: int(top * outline.scale)] = False
    near[-2:], near[:, :2], near[:, -2:] = False, False, False
    rows, columns = (index[:: -(-len(index) // MAXIMUM_POINTS) or 1] for index in np.nonzero(near))
    normals = np.stack((across, down), axis=-1)[rows, columns] / slope[rows, columns, None]
    return (np.stack((columns, rows), axis=-1) + 0.5) / outline.scale, normals


def _without_scale(motions: Float[np.ndarray, "T 3 3"], center: Float[np.ndarray, "2"]) -> np.ndarray:
    """Rigid motions with the same roll, which move the center alike."""
    result = motions.copy()
    result[:, :2, :2] /= np.hypot(motions[:, 0, 0], motions[:, 1, 0])[:, None, None]
    result[:, :2, 2] += (motions - result)[:, :2, :2] @ center
    return result


def _corrections(
    motions: Float[np.ndarray, "T 3 3"],
    points: Float[np.ndarray, "P 2"],
    normals: Float[np.ndarray, "P 2"],
    outline: OutlineDistances,
    deviations: Float[np.ndarray, " T"],
    outline_deviation: float,
    smoothness: float,
) -> Float[np.ndarray, "T 3 3"]:
    """Shift, roll and scale of every frame after `motions`, by robust Gauss–Newton on all frames at once.

    Args:
        motions: From the mean outline to every frame.
        points: Of the mean outline, px.
        normals: Into the torso.
        outline: Distances to the outline in all frames.
        deviations: Standard deviation of the motions, px.
        outline_deviation: Standard deviation of the outline, px.
        smoothness: Penalty on second differences, relative to the information of a fully constraining outline; what
            the outline constrains less is smoothed more.
    """
    center = points.mean(axis=0)
    arms = points - center
    radius = np.sqrt((arms**2).sum(axis=1).mean())
    # derivative of the distance by shift, roll and scale, the latter two in pixels at the mean radius
    jacobian = np.column_stack(
        (normals, (normals * (arms @ QUARTER_TURN)).sum(1) / radius, (normals * arms).sum(1) / radius)
    )
    prior_stds = np.column_stack((deviations, deviations, deviations, np.full(len(deviations), SCALE_STD * radius)))
    prior = prior_stds[:, None] ** -2 * np.eye(4)
    metric = smoothness * EFFECTIVE_OUTLINE_POINTS / outline_deviation**2 * np.eye(4)
    moved = points @ motions[:, :2, :2].transpose(0, 2, 1) + motions[:, None, :2, 2]
    centers = moved.mean(axis=1, keepdims=True)
    arms, parameters = moved - centers, np.zeros((len(motions), 4))
    for robust_scale in ROBUST_SCALES:
        turned = parameters[:, 2, None, None] * (arms @ QUARTER_TURN) + parameters[:, 3, None, None] * arms
        positions = moved + parameters[:, None, :2] + turned / radius
        distances, valid = sample_distances(outline, slice(None), positions)
        constant = np.ma.median(np.ma.array(distances, mask=~valid), axis=0).filled(0.0)
        residuals = distances - constant
        weights = robust_weights(residuals[..., None], valid / outline_deviation**2, 3 * robust_scale)
        weights *= EFFECTIVE_OUTLINE_POINTS / np.maximum(valid.sum(axis=1, keepdims=True), MINIMUM_OUTLINE_POINTS)
        information = np.einsum("tp,pa,pb->tab", weights, jacobian, jacobian)
        gradient = np.einsum("tab,tb->ta", information, parameters) - np.einsum(
            "tp,tp,pa->ta", weights, residuals, jacobian
        )
        parameters = solve_smoothed(information + prior, gradient, metric)
    return _similarities(parameters, centers[:, 0], radius)


def _similarities(parameters: Float[np.ndarray, "T 4"], centers: Float[np.ndarray, "T 2"], radius: float) -> np.ndarray:
    """Matrices of shifts (px), and of rolls and scales about the centers (px at the radius)."""
    result = np.tile(np.eye(3), (len(parameters), 1, 1))
    roll, scale = parameters[:, 2] / radius, 1 + parameters[:, 3, None] / radius
    linear = scale * np.array([np.cos(roll), -np.sin(roll), np.sin(roll), np.cos(roll)]).T
    result[:, :2, :2] = linear.reshape(-1, 2, 2)
    result[:, :2, 2] = centers - np.einsum("tab,tb->ta", result[:, :2, :2], centers) + parameters[:, :2]
    return result
