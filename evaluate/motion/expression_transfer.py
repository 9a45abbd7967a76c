"""Carries what one face shows over to another: by ARKit scores, and by the axes that both heads have.

Two people's codes are comparable where an axis has one name and one meaning; axes of a subject's own are not. Scores are
comparable between any two faces. The target's codes are the most likely ones given both: a Gaussian prior learned from
the target's clip, conditioned on the driver's change of scores and on its change of shared codes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from evaluate.motion.face import GAZE, Face, conditioned, logit_variance
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
    by_scores = driver.scores is not None and target.score_map is not None
    here, there = _shared_columns(driver, target)
    facial = [
        name for name in (target.layout.names[column] for column in there) if not name.startswith(("joint", "lid"))
    ]
    if not by_scores and not facial:
        raise InputError(
            "expected a driver with expression scores, or with the target's expression axes, found neither: its head has "
            "other axes, and no face was measured (docs/driving.md); prepare both videos in the same way, or have "
            "the face landmarker: ggavatar-models --fetch face_landmarker"
        )
    spread = np.maximum(driver.codes[:, here].std(axis=0), 0.5 * target.codes[:, there].std(axis=0))
    changes = driver.codes[:, here] - driver.rest[here]
    select = np.eye(len(target.rest))[there]
    if not by_scores or driver.scores is None or target.score_map is None:
        exact = np.full(len(there), EXACT**2)
        return np.stack([target.rest + conditioned(target.covariance, select, change, exact) for change in changes])
    wanted = np.clip(driver.scores - driver.rest_scores + target.rest_scores, 0, 1)
    compared = np.ones(len(GAZE), bool)
    observe = np.concatenate((target.score_map.slopes[compared], select))
    at_rest = target.score_map.logits(target.rest)
    codes, noise = [], (SHARED_NOISE * spread + LEAST_NOISE) ** 2
    for scores, change in zip(interpolated(wanted), changes, strict=True):
        observed = np.concatenate(((score_logits(scores) - at_rest)[compared], change))
        variance = np.concatenate((logit_variance(target.score_map, scores)[compared], noise))
        codes.append(target.rest + conditioned(target.covariance, observe, observed, variance))
    return np.stack(codes)


def _both_have_eyes(driver: Face, target: Face) -> bool:
    """Whether where the eyes look is known from their rotations, which is better than by scores."""
    return all(len(face.layout.columns("joint left_eye")) and np.ptp(face.codes[:, face.layout.columns("joint left_eye")]) > 0 for face in (driver, target))


def _shared_columns(driver: Face, target: Face) -> tuple[np.ndarray, np.ndarray]:
    """Columns of driver and target that have one name and one meaning."""
    if not driver.layout.expressions and driver.score_map is None and driver.scores is not None:
        return np.array([], int), np.array([], int)  # a recording of scores: its joints and lids are placeholders
    names = driver.layout.names
    there = [
        column for column, name in enumerate(target.layout.names) if target.layout.shared[column] and name in names
    ]
    return np.array([names.index(target.layout.names[column]) for column in there], int), np.array(there, int)
