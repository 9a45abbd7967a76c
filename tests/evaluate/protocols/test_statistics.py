"""Summaries against numpy, the bootstrap against the exact interval of independent and of dependent series."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluate.protocols.statistics import block_length, deviation_over_seeds, paired_bootstrap, summarize


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=60))
def test_summary_equals_numpy(values: list[float]) -> None:
    found = summarize(values, higher_is_better=True)
    assert found.mean == pytest.approx(np.mean(values), rel=1e-9, abs=1e-6)
    assert found.median == pytest.approx(np.median(values), rel=1e-9, abs=1e-9)
    assert found.std_over_frames == pytest.approx(np.std(values, ddof=1), rel=1e-6, abs=1e-6)
    count = max(1, math.ceil(len(values) / 20))
    assert found.worst_5_percent == pytest.approx(np.mean(np.sort(values)[:count]), rel=1e-9, abs=1e-6)


def test_the_worst_of_a_distance_is_its_largest() -> None:
    values = [float(k) for k in range(40)]
    assert summarize(values, higher_is_better=False).worst_5_percent == 38.5
    assert summarize(values, higher_is_better=True).worst_5_percent == 0.5


def test_identical_and_unmeasured_frames_are_counted_apart() -> None:
    found = summarize([30.0, math.inf, None, 32.0], higher_is_better=True)
    assert (found.mean, found.count, found.identical) == (31.0, 2, 1)
    only = summarize([math.inf, math.inf], higher_is_better=True)
    assert (only.mean, only.median, only.count, only.identical) == (None, None, 0, 2)
    assert summarize([5.0], higher_is_better=True).std_over_frames is None
    assert summarize([], higher_is_better=True).mean is None


def test_blocks_span_a_second_of_source_frames_but_at_most_a_quarter() -> None:
    assert block_length(range(200)) == 25
    assert block_length(range(0, 4000, 20)) == 1
    assert block_length(range(40)) == 10
    assert block_length([7]) == block_length([]) == 1


def test_independent_frames_give_the_textbook_interval() -> None:
    values = np.random.default_rng(1).normal(0.3, 1.0, 400)
    found = paired_bootstrap([(range(0, 400 * 30, 30), values.tolist())])
    assert found is not None
    half = 1.96 * values.std(ddof=1) / 20
    assert found.mean == pytest.approx(values.mean())
    assert found.high - found.mean == pytest.approx(half, rel=0.1)
    assert found.mean - found.low == pytest.approx(half, rel=0.1)
    assert found.is_significant


def test_neighboring_frames_that_err_alike_widen_the_interval() -> None:
    noise = np.random.default_rng(2).normal(size=40)
    values = np.repeat(noise, 25)
    dependent = paired_bootstrap([(range(1000), values.tolist())])
    pretended = paired_bootstrap([(range(0, 1000 * 25, 25), values.tolist())])
    assert dependent is not None
    assert pretended is not None
    assert dependent.block == 25
    assert pretended.block == 1
    ratio = (dependent.high - dependent.low) / (pretended.high - pretended.low)
    assert ratio > 3


def test_the_interval_is_reproducible_and_none_without_frames() -> None:
    groups = [(range(50), np.linspace(-1, 2, 50).tolist()), (range(30), np.linspace(0, 1, 30).tolist())]
    first, second = paired_bootstrap(groups), paired_bootstrap(groups)
    assert first == second
    assert first is not None
    assert first.mean == pytest.approx(0.5)
    assert first.frames == 80
    assert paired_bootstrap([]) is None
    assert paired_bootstrap([([], [])]) is None


def test_a_constant_difference_is_certain_and_zero_is_not_significant() -> None:
    certain = paired_bootstrap([(range(40), [0.25] * 40)])
    assert certain is not None
    assert certain.low == pytest.approx(0.25)
    assert certain.high == pytest.approx(0.25)
    nothing = paired_bootstrap([(range(40), [0.0] * 40)])
    assert nothing is not None
    assert not nothing.is_significant


def test_deviation_over_seeds_needs_two() -> None:
    assert deviation_over_seeds([30.0]) is None
    assert deviation_over_seeds([30.0, 31.0]) == pytest.approx(math.sqrt(0.5))
