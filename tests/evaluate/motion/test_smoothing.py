"""Filters fed value by value against those fed with whole sequences."""

from __future__ import annotations

import numpy as np

from evaluate.motion.smoothing import OneEuro, one_euro


def test_values_one_by_one_are_filtered_like_the_whole() -> None:
    values = np.random.default_rng(2).standard_normal((40, 3)).cumsum(axis=0)
    smooth = OneEuro(values.std(axis=0))
    np.testing.assert_array_equal(np.array([smooth(row, 1 / 30) for row in values]), one_euro(values, 30.0))


def test_the_filter_keeps_the_first_value_and_comes_to_rest_at_the_last() -> None:
    smooth = OneEuro(np.ones(1))
    found = [float(smooth(np.array([value]), 1 / 25)[0]) for value in [1.0] * 3 + [2.0] * 200]
    assert found[:3] == [1.0] * 3 and 1.0 < found[3] < 2.0 and abs(found[-1] - 2.0) < 1e-6
