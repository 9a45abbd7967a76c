"""The map from one person's facial codes to ARKit's expression scores, learned from the person's own frames.

The network that measures the scores ends in a sigmoid, so their logits are nearly linear in the face's motion, where
the scores themselves saturate: a low brow raised by half has the score of one that is not raised at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logit

from evaluate.motion.score_agreement import SMALLEST_DEVIATION, agreement

STRENGTHS = (1e-4, 1e-3, 1e-2, 1e-1)
"""Ridge penalties to choose from, per frame and unit variance of a code."""
FOLDS = 5
SMALLEST_SCORE = 0.003
"""Scores nearer to 0 or 1 say no more."""


def score_logits(scores: Float[np.ndarray, "*T S"]) -> Float[np.ndarray, "*T S"]:
    """Logits of scores, bounded."""
    return logit(np.clip(scores, SMALLEST_SCORE, 1 - SMALLEST_SCORE))


@dataclass(frozen=True)
class ScoreMap:
    """logit(scores) ≈ mean + slopes · (codes − codes_mean).

    Attributes:
        slopes: Change of each logit per unit of each code.
        codes_mean: Of the frames it was learned from.
        mean: Of the logits, likewise.
        deviation: Standard deviation of the logits about the map.
        correlation: Between predicted and measured scores of frames that were left out, weighted by their deviation.
    """

    slopes: Float[np.ndarray, "S K"]
    codes_mean: Float[np.ndarray, " K"]
    mean: Float[np.ndarray, " S"]
    deviation: Float[np.ndarray, " S"]
    correlation: float

    def logits(self, codes: Float[np.ndarray, "*T K"]) -> Float[np.ndarray, "*T S"]:
        """The logits of the scores that codes lead to."""
        return self.mean + (codes - self.codes_mean) @ self.slopes.T


def fit_score_map(
    codes: Float[np.ndarray, "T K"], scores: Float[np.ndarray, "T S"], expected: Float[np.ndarray, "S K"]
) -> ScoreMap:
    """Ridge regression towards expected slopes; its penalty is the one that predicts best what it has not seen.

    Args:
        codes: Facial codes.
        scores: Measured scores in [0, 1].
        expected: Slopes of codes that the clip does not show moving.
    """
    logits, weights = score_logits(scores), certainty(scores)
    rest = logits - codes @ expected.T
    tried = {strength: _held_out_correlation(codes, rest, logits, strength) for strength in STRENGTHS}
    best = max(tried, key=tried.__getitem__)
    fit = _Ridge(codes, rest, weights, best)
    residual = rest - fit(codes)
    deviation = np.sqrt((weights * residual**2).sum(axis=0) / weights.sum(axis=0))
    center = codes.mean(axis=0)
    mean = fit(center[None])[0] + expected @ center
    return ScoreMap(expected + fit.slopes, center, mean, deviation, tried[best])


def certainty(scores: Float[np.ndarray, "*T S"], least: float = SMALLEST_SCORE) -> Float[np.ndarray, "*T S"]:
    """Weights of logits: the derivative of the sigmoid, since the scores' own noise is the same everywhere.

    Args:
        scores: In [0, 1].
        least: Scores nearer to 0 or 1 count like this one.
    """
    bounded = np.clip(scores, least, 1 - least)
    return bounded * (1 - bounded)


class _Ridge:
    """Weighted ridge regression, one for every column of values."""

    def __init__(self, codes: np.ndarray, values: np.ndarray, weights: np.ndarray, strength: float) -> None:
        shares = weights / weights.sum(axis=0)
        self.center, self.mean = shares.T @ codes, (shares * values).sum(axis=0)
        unit = np.maximum(codes.std(axis=0), SMALLEST_DEVIATION)
        self.slopes = np.empty((values.shape[1], codes.shape[1]))
        for column in range(values.shape[1]):
            scaled = (codes - self.center[column]) / unit
            weighted = shares[:, column, None] * scaled
            normal = weighted.T @ scaled + strength * np.eye(len(unit))
            self.slopes[column] = np.linalg.solve(normal, weighted.T @ (values[:, column] - self.mean[column])) / unit

    def __call__(self, codes: np.ndarray) -> np.ndarray:
        return self.mean + codes @ self.slopes.T - (self.slopes * self.center).sum(axis=1)


def _held_out_correlation(codes: np.ndarray, rest: np.ndarray, logits: np.ndarray, strength: float) -> float:
    """Correlation of predicted scores for folds that a map has not seen; neighboring frames stay in one fold.

    The map is learned from `rest`, the logits without what expected slopes explain.
    """
    folds = np.arange(len(codes)) * min(FOLDS, len(codes)) // len(codes)
    weights, predicted = certainty(expit(logits)), logits - rest
    for fold in np.unique(folds):
        seen, left = folds != fold, folds == fold
        predicted[left] += _Ridge(codes[seen], rest[seen], weights[seen], strength)(codes[left])
    return agreement(expit(logits), expit(predicted)).correlation
