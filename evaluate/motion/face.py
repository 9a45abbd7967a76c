"""A person's face over a clip: facial codes, the scores they lead to, and both at rest.

Codes at rest are computed, not picked: many clips show no frame in which the whole face is at rest. Rest is where every
score is as low as it often gets, the eyes look straight ahead, and codes are no larger than that needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluate.motion.driving_sequence import DrivingSequence
from evaluate.motion.facial_codes import FacialLayout, facial_codes, facial_layout
from evaluate.motion.neutral import neutral_row
from evaluate.motion.score_map import ScoreMap, certainty, fit_score_map, score_logits
from ggavatar.landmarks.blendshapes import NAMES

SCORES = NAMES[1:]
"""Scores that are compared: all but `neutral`."""
REST_PERCENTILE = 20
"""How often a score is lower than at rest, %."""
GAZE = np.array([name.startswith("eyeLook") for name in SCORES])
SIDEWAYS = np.array([name.startswith(("eyeLookIn", "eyeLookOut")) for name in SCORES])
WIDENING = 4.0
"""Factor on the clip's covariance of codes: other performances may move twice as far."""
SHARED_SPREAD, OWN_SPREAD, JOINT_SPREAD, LID_SPREAD = 0.6, 0.1, 0.1, 0.3
"""Standard deviations of codes that hardly move in a clip: shared and own axes, rotations (rad), lids."""
_NAMED_AFTER = {
    "joint jaw 0": ("jawOpen", 10.0),
    "lid left": ("eyeBlinkLeft", 5.0),
    "lid right": ("eyeBlinkRight", 5.0),
}
"""Scores that joints and lids stand for, with the change of their logit per rad or unit."""
FULL_EXPRESSION = 5.0
"""Change of a score's logit per unit of the axis that is named after it; measured 3 (brows) to 6 (smile)."""
SATURATED = 0.05
"""Scores nearer to 0 or 1 tell as much as this one."""
SCORE_NOISE = 0.1
"""Standard deviation of a measured score about the truth."""


@dataclass(frozen=True)
class Face:
    """One person's facial codes.

    Attributes:
        layout: What the codes are.
        codes: Of every frame.
        scores: Measured, in the order of `SCORES`; None if there are none.
        score_map: From codes to scores; None likewise, and for recordings that have scores only.
        covariance: Prior covariance of the codes about rest.
        rest: Codes at rest.
        rest_scores: Scores at rest; zeros without scores.
    """

    layout: FacialLayout
    codes: Float[np.ndarray, "T K"]
    scores: Float[np.ndarray, "T S"] | None
    score_map: ScoreMap | None
    covariance: Float[np.ndarray, "K K"]
    rest: Float[np.ndarray, " K"]
    rest_scores: Float[np.ndarray, " S"]


def face_of(sequence: DrivingSequence, rest_row: int | None = None) -> Face:
    """The face of a sequence.

    Args:
        sequence: Frames whose scores are NaN are not learned from; scores are known in two or more, or in none.
        rest_row: A frame that shows the face at rest; by default rest is computed.
    """
    layout = facial_layout(sequence)
    codes = facial_codes(sequence, layout)
    covariance = _prior_covariance(codes, layout)
    scores = None if sequence.scores is None else sequence.scores[:, 1:]
    if scores is None:
        rest = codes[neutral_row(sequence) if rest_row is None else rest_row]
        return Face(layout, codes, None, None, covariance, rest, np.zeros(len(SCORES)))
    known = np.isfinite(scores).all(axis=1)
    mapped = None
    if sequence.expression.shape[1]:
        mapped = fit_score_map(codes[known], scores[known], expected_slopes(layout))
    rest_scores = _scores_at_rest(scores[known])
    if rest_row is not None:
        rest_scores = scores[rest_row] if known[rest_row] else rest_scores
        return Face(layout, codes, scores, mapped, covariance, codes[rest_row], rest_scores)
    rest = _codes_at_rest(codes, layout, mapped, covariance, rest_scores) if mapped else np.zeros(codes.shape[1])
    return Face(layout, codes, scores, mapped, covariance, rest, rest_scores)


def expected_slopes(layout: FacialLayout) -> Float[np.ndarray, "S K"]:
    """Slopes of the scores' logits by what the codes are named after; zero for codes without such a name."""
    slopes = np.zeros((len(SCORES), len(layout.names)))
    for column, name in enumerate(layout.names):
        score, per_unit = _NAMED_AFTER.get(name, (name, FULL_EXPRESSION))
        if score in SCORES:
            slopes[SCORES.index(score), column] = per_unit
    return slopes


def conditioned(
    covariance: Float[np.ndarray, "K K"],
    observe: Float[np.ndarray, "M K"],
    observed: Float[np.ndarray, " M"],
    variance: Float[np.ndarray, " M"],
) -> Float[np.ndarray, " K"]:
    """Mean of a Gaussian about zero, given noisy linear observations.

    Args:
        covariance: Of the prior.
        observe: What is observed, as a linear map.
        observed: The observations.
        variance: Of each observation's noise.
    """
    through = covariance @ observe.T
    return through @ np.linalg.solve(observe @ through + np.diag(variance), observed)


def logit_variance(mapped: ScoreMap, scores: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Variance of the logits of measured scores about those that a map predicts: larger towards 0 and 1, to a limit."""
    return mapped.deviation**2 + (SCORE_NOISE / certainty(scores, SATURATED)) ** 2


def _prior_covariance(codes: Float[np.ndarray, "T K"], layout: FacialLayout) -> Float[np.ndarray, "K K"]:
    spread = np.where(layout.shared, SHARED_SPREAD, OWN_SPREAD)
    spread[layout.columns("joint ")] = JOINT_SPREAD
    spread[layout.columns("lid ")] = LID_SPREAD
    centered = codes - codes.mean(axis=0)
    return WIDENING * (centered.T @ centered) / max(len(codes) - 1, 1) + np.diag(spread**2)


def _scores_at_rest(scores: Float[np.ndarray, "T S"]) -> Float[np.ndarray, " S"]:
    """Low scores, and eyes that look straight ahead at their usual height."""
    rest = np.percentile(scores, REST_PERCENTILE, axis=0)
    rest[GAZE] = np.median(scores[:, GAZE], axis=0)
    rest[SIDEWAYS] = np.percentile(scores[:, SIDEWAYS], REST_PERCENTILE, axis=0).mean()
    return rest


def _codes_at_rest(
    codes: Float[np.ndarray, "T K"],
    layout: FacialLayout,
    mapped: ScoreMap,
    covariance: Float[np.ndarray, "K K"],
    rest_scores: Float[np.ndarray, " S"],
) -> Float[np.ndarray, " K"]:
    """The most likely codes that lead to the scores at rest; a priori zero, and eyes that look where they often do."""
    start = np.median(codes, axis=0)
    start[: len(layout.expressions)] *= not layout.zero_is_rest
    start[layout.columns("joint jaw")] = 0.0
    start[layout.columns("lid ")] = 0.0
    observed = score_logits(rest_scores) - mapped.logits(start)
    return start + conditioned(covariance, mapped.slopes, observed, logit_variance(mapped, rest_scores))
