"""Numbers as 8 or 16 bits with an affine scale per row or column, such that zeros stay exactly zero."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

TINY_RANGE = 1e-12
"""Ranges of constant columns are taken as this, so that no step is zero."""
ZERO_WITHIN = 1e-2
"""Numbers this close to zero, in steps, are zero: `low`, rounded to float32, is up to 0.004 of 65,535 steps off."""


class Quantized(NamedTuple):
    """x ≈ low + step · values, with `low` and `step` of shape [1, C] (per column) or [R, 1] (per row)."""

    values: np.ndarray
    low: Float[np.ndarray, "..."]
    step: Float[np.ndarray, "..."]


def quantize(
    numbers: Float[np.ndarray, "R C"], bits: Literal[8, 16], per: Literal["row", "column"] = "column"
) -> Quantized:
    """Round to 2^bits levels between the extremes of every row or column.

    Where zero lies between the extremes it is one of the levels, so that sparse arrays stay sparse.
    """
    axis = 0 if per == "column" else 1
    least, most = numbers.min(axis=axis, keepdims=True), numbers.max(axis=axis, keepdims=True)
    top = 2**bits - 1
    step = np.maximum(most - least, TINY_RANGE) / top
    low = np.where((least < 0) & (most > 0), -step * np.rint(-least / step), least)
    low, step = low.astype(np.float32), step.astype(np.float32)
    values = np.clip(np.rint((numbers - low) / step), 0, top)
    return Quantized(values.astype(np.uint8 if bits == 8 else np.uint16), low, step)


def dequantize(stored: Quantized) -> Float[np.ndarray, "R C"]:
    """The numbers again, as the page computes them: low + step · value in float64, and zero where it rounds to zero."""
    step = stored.step.astype(np.float64)
    numbers = stored.low.astype(np.float64) + step * stored.values
    return np.where(np.abs(numbers) < ZERO_WITHIN * step, 0, numbers).astype(np.float32)
