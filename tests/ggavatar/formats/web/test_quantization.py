"""Rounding to 8 and 16 bits: the bound of half a step, exact zeros, constant columns."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ggavatar.formats.web.quantization import dequantize, quantize


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("per", ["row", "column"])
def test_the_error_is_at_most_half_a_step(bits: Literal[8, 16], per: Literal["row", "column"]) -> None:
    numbers = np.random.default_rng(1).normal(size=(40, 30)).astype(np.float32) * np.logspace(-3, 3, 30)
    numbers = numbers.astype(np.float32)
    stored = quantize(numbers, bits, per)
    assert stored.values.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert stored.step.shape == ((1, 30) if per == "column" else (40, 1))
    error = np.abs(dequantize(stored).astype(np.float64) - numbers)
    assert (error <= 0.5001 * stored.step + 1e-6 * np.abs(numbers)).all()
    assert error.max() > 0.3 * stored.step.min(), "it rounds"


def test_zeros_stay_exactly_zero() -> None:
    numbers = np.random.default_rng(2).normal(size=(200, 7)).astype(np.float32) * np.float32(0.0123)
    numbers[::3] = 0
    for bits in (8, 16):
        again = dequantize(quantize(numbers, bits))
        assert (again[::3] == 0).all(), "sparse bases stay sparse"
        assert (quantize(numbers, bits).low != 0).all(), "zero lies between the extremes"


@given(arrays(np.float32, (3, 4), elements=st.floats(-1e4, 1e4, width=32)))
def test_any_numbers_come_back_in_their_range(numbers: np.ndarray) -> None:
    stored = quantize(numbers, 8)
    again = dequantize(stored)
    slack = 0.5 * stored.step[0] + 1e-5 * np.abs(numbers).max(axis=0) + 1e-9  # levels move so that zero is one
    assert (again >= numbers.min(axis=0) - slack).all() and (again <= numbers.max(axis=0) + slack).all()


def test_a_constant_column_is_kept() -> None:
    numbers = np.full((5, 2), 3.25, np.float32)
    numbers[:, 1] = 0
    assert (dequantize(quantize(numbers, 8)) == numbers).all()
