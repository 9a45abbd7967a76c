"""Correlation and slope of tables of scores, against scipy's regression and closed forms."""

from __future__ import annotations

import numpy as np
from scipy.stats import linregress

from evaluate.motion.score_agreement import agreement

RANDOM = np.random.default_rng(1)


def test_columns_are_those_of_a_regression_and_weighted_by_the_first() -> None:
    first = RANDOM.uniform(0, 1, (40, 3)) * [1.0, 0.2, 0.5]
    second = 0.4 * first + RANDOM.normal(0, 0.02, first.shape) + 0.1
    found = agreement(first, second)
    for column in range(3):
        expected = linregress(first[:, column], second[:, column])
        np.testing.assert_allclose(found.slopes[column], expected.slope)
        np.testing.assert_allclose(found.correlations[column], expected.rvalue)
    shares = first.std(axis=0) / first.std(axis=0).sum()
    np.testing.assert_allclose(found.slope, (shares * found.slopes).sum())
    np.testing.assert_allclose(found.correlation, (shares * found.correlations).sum())


def test_opposite_columns_count_by_their_deviation() -> None:
    time = np.arange(50.0)
    first = np.stack((np.sin(time), 0.01 * np.cos(time)), axis=1)
    second = np.stack((np.sin(time), -np.cos(time)), axis=1)
    np.testing.assert_allclose(agreement(first, second).correlation, (1 - 0.01) / 1.01, atol=2e-3)


def test_what_does_not_vary_agrees_with_nothing() -> None:
    first = RANDOM.uniform(0, 1, (40, 5))
    still = agreement(first, np.full_like(first, 0.4))
    assert abs(still.slope) < 1e-12 and abs(still.correlation) < 1e-6
    same = agreement(np.full((4, 5), 0.2), RANDOM.uniform(0, 1, (4, 5)))
    assert np.isfinite([same.slope, same.correlation]).all()
