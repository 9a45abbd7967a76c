"""Repeated frames. Reference: conversions that show frame floor(k · in / out) of the input, as ffmpeg does."""

from __future__ import annotations

import numpy as np
import pytest

from preprocess.evidence.repeats import frozen_runs, kind_of_repeats, rate_without_repeats


def converted(rate, out, count=300):
    shown = np.floor(np.arange(count) * rate / out + 1e-9)
    return np.concatenate(([False], np.diff(shown) == 0))


@pytest.mark.parametrize(("rate", "out"), [(24, 30), (24, 25), (15, 30), (10, 30), (12, 60), (10, 25), (23.976, 30)])
def test_conversions_from_a_lower_rate(rate, out):
    repeated = converted(rate, out)
    assert kind_of_repeats(repeated) == "rate"
    assert rate_without_repeats(float(out), repeated) == pytest.approx(rate, rel=0.01)


def test_a_frozen_picture_is_not_a_rate():
    repeated = np.zeros(200, bool)
    repeated[60:90], repeated[150] = True, True
    assert kind_of_repeats(repeated) == "frozen" and frozen_runs(repeated) == [(60, 89)]
    assert rate_without_repeats(30.0, repeated) == pytest.approx(30 * 169 / 170), "time stands still while it is frozen"


def test_repeats_here_and_there():
    repeated = np.zeros(200, bool)
    repeated[[3, 9, 11, 50, 51, 52, 120, 121, 190]] = True
    assert kind_of_repeats(repeated) == "irregular" and rate_without_repeats(25.0, np.zeros(9, bool)) == 25
