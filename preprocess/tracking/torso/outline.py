"""How the shoulders' outline moves in the image: what texture alone gets wrong, and what bare or plain shoulders hide.

The mask's edge below the chin says how the shoulders moved across it. What the texture told of the torso is the
starting point and holds what the outline cannot tell (two straight shoulders hardly tell size from height).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import robust_weights, solve_smooth
from preprocess.tracking.geometry.smoothing import penalty
from preprocess.tracking.pose.outline_cue import STEPS, Edges, sampled

SIZE_ERROR = 0.01
"""Share by which a torso may come nearer; texture's own word on size is not heard, it was worse than none."""
CUTOFF = 2.5
"""Fastest motion kept where the outline tells it well, Hz."""
TEXTURE_ERROR, REST_ERROR = 0.015, 0.06
"""Over the face's height: how far off the texture's motion may be, and rest where it tells none."""
OUTLINE_ERROR = 0.004
"""Over the face's height: of the outline's place, apart from what is always there."""
OUTLINE_COUNT = 8.0
"""As many independent places of the outline as all of them are worth."""
ENOUGH_PLACES = 12
"""Fewer places of the outline in the first frames tell nothing."""
FRAMES, PLACES = 200, 100
"""As many frames tell where the outline usually is, and as many places of it are looked at."""
BELOW_CHIN = 0.05
"""How far below the chin the torso begins, over the face's height."""
LOOSENESS = (8.0, 4.0, 2.0, 1.0, 1.0)
"""In every round, how many times further off than usual a place may be before it counts less."""
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""A place's own quarter turn in the image, to multiply from the right: what a small roll adds."""


def outline_motions(
    motions: Sequence[Float[np.ndarray, "3 3"] | None], edges: Edges, faces: Float[np.ndarray, "T 2"], fps: float
) -> list[np.ndarray | None]:
    """Similarities of the shoulders' outline from the first frame's pixels to each.

    Args:
        motions: What texture told; None where it told nothing.
        edges: The masks' outlines.
        faces: Rows of every face's upper and lower end, px.
        fps: Frames a second.

    Returns:
        As `motions`, which come back unchanged where there is no outline below the chin.
    """
    told = np.array([motion is not None for motion in motions])
    start = np.stack([np.eye(3) if motion is None else motion for motion in motions])
    height = float(np.median(faces[:, 1] - faces[:, 0]))
    places, normals = _outline(edges, float(np.median(faces[:, 1])) + BELOW_CHIN * height)
    if len(places) < ENOUGH_PLACES:
        return list(motions)
    usual = start[np.argmin(np.abs(start[:, :2, 2] - np.median(start[:, :2, 2], axis=0)).sum(axis=1))]
    doubts = np.where(told, TEXTURE_ERROR, REST_ERROR) * height
    moves = _without_size(start @ np.linalg.inv(usual), places.mean(axis=0))
    strength = penalty(CUTOFF, fps) if len(start) > 2 else 0.0
    return list(_corrections(moves, places, normals, edges, doubts, OUTLINE_ERROR * height, strength) @ moves @ usual)


def _outline(edges: Edges, top: float) -> tuple[Float[np.ndarray, "P 2"], Float[np.ndarray, "P 2"]]:
    """Where the outline usually is below row `top`, px, and the unit normals into the torso.

    Pixels count whose median distance over the clip is less than one; the picture's border is left out.
    """
    step = -(-len(edges.distances) // FRAMES)
    distances = np.median(edges.distances[::step], axis=0).astype(np.float64)
    down, across = np.gradient(cv2.GaussianBlur(distances, (0, 0), 1.0))
    steep = np.hypot(across, down)
    near = (np.abs(distances) < STEPS) & (steep > 0.5 * STEPS)
    near[: int(top * edges.scale)] = False
    near[-2:], near[:, :2], near[:, -2:] = False, False, False
    rows, columns = (index[:: -(-len(index) // PLACES) or 1] for index in np.nonzero(near))
    normals = np.stack((across, down), axis=-1)[rows, columns] / steep[rows, columns, None]
    return (np.stack((columns, rows), axis=-1) + 0.5) / edges.scale, normals


def _without_size(motions: Float[np.ndarray, "T 3 3"], middle: Float[np.ndarray, "2"]) -> np.ndarray:
    """The same motions of the middle, with the same roll."""
    result = motions.copy()
    result[:, :2, :2] /= np.hypot(motions[:, 0, 0], motions[:, 1, 0])[:, None, None]
    result[:, :2, 2] += (motions - result)[:, :2, :2] @ middle
    return result


def _corrections(
    motions: Float[np.ndarray, "T 3 3"],
    places: Float[np.ndarray, "P 2"],
    normals: Float[np.ndarray, "P 2"],
    edges: Edges,
    doubts: Float[np.ndarray, " T"],
    error: float,
    strength: float,
) -> Float[np.ndarray, "T 3 3"]:
    """Shift, roll and size of every frame after `motions`, which lead from the usual torso to the frame's.

    Args:
        motions: Of the places into every frame.
        places: Of the outline, px.
        normals: Into the torso.
        edges: Outlines of all frames.
        doubts: How far off the motions may be, px.
        error: How far off the outline may be, px.
        strength: Penalty on second differences, against what the outline tells where it tells all; what it hardly
            tells is smoothed the more.
    """
    middle = places.mean(axis=0)
    arms = places - middle
    reach = np.sqrt((arms**2).sum(axis=1).mean())
    # how a place moves across the outline with shift, roll and size, these two told in pixels at a usual place
    slopes = np.column_stack((normals, (normals * (arms @ TURN)).sum(1) / reach, (normals * arms).sum(1) / reach))
    doubted = np.column_stack((doubts, doubts, doubts, np.full(len(doubts), SIZE_ERROR * reach)))
    trust = doubted[:, None] ** -2 * np.eye(4)
    metric = strength * OUTLINE_COUNT / error**2 * np.eye(4)
    moved = places @ motions[:, :2, :2].transpose(0, 2, 1) + motions[:, None, :2, 2]
    centers = moved.mean(axis=1, keepdims=True)
    arms, parts = moved - centers, np.zeros((len(motions), 4))
    for looseness in LOOSENESS:
        turned = parts[:, 2, None, None] * (arms @ TURN) + parts[:, 3, None, None] * arms
        here = moved + parts[:, None, :2] + turned / reach
        distances, known = sampled(edges, slice(None), here)
        always = np.ma.median(np.ma.array(distances, mask=~known), axis=0).filled(0.0)
        left = distances - always
        weights = robust_weights(left[..., None], known / error**2, 3 * looseness)
        weights *= OUTLINE_COUNT / np.maximum(known.sum(axis=1, keepdims=True), ENOUGH_PLACES)
        information = np.einsum("tp,pa,pb->tab", weights, slopes, slopes)
        wanted = np.einsum("tab,tb->ta", information, parts) - np.einsum("tp,tp,pa->ta", weights, left, slopes)
        parts = solve_smooth(information + trust, wanted, metric)
    return _matrices(parts, centers[:, 0], reach)


def _matrices(parts: Float[np.ndarray, "T 4"], middles: Float[np.ndarray, "T 2"], reach: float) -> np.ndarray:
    """Shifts, rolls and sizes about the middles as matrices."""
    result = np.tile(np.eye(3), (len(parts), 1, 1))
    turn, size = parts[:, 2] / reach, 1 + parts[:, 3, None] / reach
    turns = size * np.array([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)]).T
    result[:, :2, :2] = turns.reshape(-1, 2, 2)
    result[:, :2, 2] = middles - np.einsum("tab,tb->ta", result[:, :2, :2], middles) + parts[:, :2]
    return result
