"""Carries what one face shows over to another: by ARKit scores, and by the axes that both heads have.

Two people's codes are comparable where an axis has one name and one meaning; axes of a subject's own are not. Scores
are comparable between any two faces. The target's codes are the most likely ones given both: a Gaussian prior learned
from the target's clip, conditioned on the driver's change of scores and on its change of shared codes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from evaluate.motion.face import SATURATED, Face, conditioned, logit_variance
from evaluate.motion.score_map import score_logits
from evaluate.motion.smoothing import interpolated
from ggavatar.errors import InputError

SHARED_NOISE, LEAST_NOISE = 0.5, 0.02
"""Standard deviation of a shared code's change between two people: as a part of its deviation, and at least."""
EXACT = 1e-6
"""Standard deviation of shared codes that nothing else is known beside."""


def carry_over(driver: Face, target: Face) -> Float[np.ndarray, "T K"]:
    """The target's codes for the driver's performance.

    Raises:
        InputError: Nothing is common to both: no scores, and no axis of the same name.
    """
    here, there = _shared_columns(driver, target)
    select = np.eye(len(target.rest))[there]
    changes = driver.codes[:, here] - driver.rest[here]
    if driver.scores is None or target.score_map is None:
        _require_shared_axes(target, there)
        exact = np.full(len(there), EXACT**2)
        return np.stack([target.rest + conditioned(target.covariance, select, change, exact) for change in changes])
    spread = np.maximum(driver.codes[:, here].std(axis=0), 0.5 * target.codes[:, there].std(axis=0))
    noise = (SHARED_NOISE * spread + LEAST_NOISE) ** 2
    observe = np.concatenate((target.score_map.slopes, select))
    at_rest = target.score_map.logits(target.rest)
    wanted = np.clip(interpolated(driver.scores) - driver.rest_scores + target.rest_scores, 0, 1 - SATURATED)
    codes = []
    for scores, change in zip(wanted, changes, strict=True):
        observed = np.concatenate((score_logits(scores) - at_rest, change))
        variance = np.concatenate((logit_variance(target.score_map, scores), noise))
        codes.append(target.rest + conditioned(target.covariance, observe, observed, variance))
    return np.stack(codes)


def _shared_columns(driver: Face, target: Face) -> tuple[np.ndarray, np.ndarray]:
    """Columns of driver and target that have one name and one meaning; none for a recording of scores alone."""
    if driver.scores is not None and driver.score_map is None:
        return np.array([], int), np.array([], int)
    names, shared = driver.layout.names, target.layout.shared
    there = [column for column, name in enumerate(target.layout.names) if shared[column] and name in names]
    return np.array([names.index(target.layout.names[column]) for column in there], int), np.array(there, int)


def _require_shared_axes(target: Face, there: np.ndarray) -> None:
    names = [target.layout.names[column] for column in there]
    if all(name.startswith(("joint ", "lid ")) for name in names):
        raise InputError(
            "expected a driver whose face was measured, or one with the avatar's expression axes, found neither: its "
            "head has other axes; prepare both videos in the same way, or fetch the network that measures faces: "
            "ggavatar-models --fetch face_landmarker"
        )
