"""The map from codes to scores, against a person whose map is known."""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from evaluate.motion.score_map import certainty, fit_score_map, score_logits

RANDOM = np.random.default_rng(3)
SLOPES = RANDOM.normal(0, 2, (6, 4))
OFFSET = RANDOM.uniform(-2, 1, 6)


def shown(codes: np.ndarray, noise: float = 0.0) -> np.ndarray:
    scores = expit(OFFSET + codes @ SLOPES.T)
    return np.clip(scores + np.random.default_rng(0).normal(0, noise, scores.shape), 0, 1)


def test_a_known_map_is_found() -> None:
    codes = RANDOM.normal(0, 0.4, (300, 4))
    found = fit_score_map(codes, shown(codes), np.zeros((6, 4)))
    np.testing.assert_allclose(found.slopes, SLOPES, atol=0.1)
    rest = np.zeros((1, 4))
    np.testing.assert_allclose(expit(found.logits(rest)), shown(rest), atol=0.01)
    assert found.correlation > 0.999 and found.deviation.max() < 0.1


def test_noise_of_scores_is_tolerated_and_reported() -> None:
    codes = RANDOM.normal(0, 0.4, (300, 4))
    found = fit_score_map(codes, shown(codes, 0.02), np.zeros((6, 4)))
    np.testing.assert_allclose(found.slopes, SLOPES, atol=0.15 * np.abs(SLOPES).max())
    assert 0.9 < found.correlation < 0.9999 and found.deviation.min() > 0.03


def test_codes_that_never_moved_keep_the_expected_slope() -> None:
    codes = RANDOM.normal(0, 0.4, (200, 4))
    codes[:, 2] = 0.0
    expected = np.zeros((6, 4))
    expected[1, 2] = 5.0
    found = fit_score_map(codes, shown(codes), expected)
    np.testing.assert_allclose(found.slopes[:, 2], expected[:, 2], atol=1e-6)
    np.testing.assert_allclose(found.slopes[:, [0, 1, 3]], SLOPES[:, [0, 1, 3]], atol=0.1)


def test_logits_are_bounded_and_trusted_least_where_scores_saturate() -> None:
    assert np.isfinite(score_logits(np.array([0.0, 0.5, 1.0]))).all() and score_logits(np.array([0.5]))[0] == 0
    np.testing.assert_allclose(certainty(np.array([0.5, 0.9])), [0.25, 0.09])
    assert certainty(np.array([0.0]))[0] < 0.005
