"""L1 and the two regularisers with their gradients in one pass each (compiled; twins in `losses`)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from ggavatar.compiled import kernel, run

CHUNK = 1 << 16
"""Numbers of a task; sums are taken per task and then in order."""
ROWS = 1 << 13
"""Rows of a task."""


@kernel
def absolute_sum(x, y, gradient):
    """Sum of |x − y|; `gradient`, unless empty, receives the signs."""
    lanes = np.zeros(16, np.float32)
    zero, one = np.float32(0), np.float32(1)
    whole = x.size // 16 * 16
    for at in range(0, whole, 16):
        for lane in range(np.uint64(16)):
            lanes[lane] += abs(x[np.uint64(at) + lane] - y[np.uint64(at) + lane])
    for i in range(whole, x.size):
        lanes[0] += abs(x[i] - y[i])
    for i in range(np.uint64(gradient.size)):
        difference = x[i] - y[i]
        gradient[i] = (one if difference > zero else zero) - (one if difference < zero else zero)
    return lanes.astype(np.float64).sum()


@kernel
def excess_of_norms(rows, visible, threshold, gradient):
    """Sum over visible rows of max(‖row‖ − threshold, 0), and its gradient."""
    total, zero, one = 0.0, np.float32(0), np.float32(1)
    for n in range(np.uint64(rows.shape[0])):
        x, y, z = rows[n, 0], rows[n, 1], rows[n, 2]
        square = x * x + y * y + z * z
        factor = zero
        if visible[n] and square > threshold * threshold:
            length = np.sqrt(square)
            total += length - threshold
            factor = one / length
        gradient[n, 0], gradient[n, 1], gradient[n, 2] = factor * x, factor * y, factor * z
    return total


@kernel
def norms_of_excess(rows, visible, threshold, gradient):
    """Sum over visible rows of ‖max(row − threshold, 0)‖, and its gradient."""
    total, zero, one = 0.0, np.float32(0), np.float32(1)
    for n in range(np.uint64(rows.shape[0])):
        x, y, z = (
            max(rows[n, 0] - threshold, zero),
            max(rows[n, 1] - threshold, zero),
            max(rows[n, 2] - threshold, zero),
        )
        square = x * x + y * y + z * z
        factor = zero
        if visible[n] and square > zero:
            length = np.sqrt(square)
            total += length
            factor = one / length
        gradient[n, 0], gradient[n, 1], gradient[n, 2] = factor * x, factor * y, factor * z
    return total


def l1_sum(x: Float32[ndarray, " K"], y: Float32[ndarray, " K"], gradient: Float32[ndarray, " _"]) -> float:
    """Sum of |x − y| and, unless `gradient` is empty, its gradient."""
    parts = [slice(first, min(first + CHUNK, x.size)) for first in range(0, x.size, CHUNK)]
    sums = [0.0] * len(parts)

    def task(index: int) -> None:
        part = parts[index]
        sums[index] = absolute_sum(x[part], y[part], gradient[part])

    run(task, len(parts))
    return sum(sums)


def rows_sum(
    kind: str,
    rows: Float32[ndarray, "N 3"],
    visible: Bool[ndarray, " N"],
    threshold: float,
    gradient: Float32[ndarray, "N 3"],
) -> float:
    """The sum and gradient of one of the two regularisers: "position" or "scale"."""
    work = {"position": excess_of_norms, "scale": norms_of_excess}[kind]
    parts = [slice(first, min(first + ROWS, len(rows))) for first in range(0, len(rows), ROWS)]
    sums = [0.0] * len(parts)

    def task(index: int) -> None:
        part = parts[index]
        sums[index] = work(rows[part], visible[part], np.float32(threshold), gradient[part])

    run(task, len(parts))
    return sum(sums)
