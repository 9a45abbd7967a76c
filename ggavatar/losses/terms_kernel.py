"""Compiled L1 and regularizers, sixteen rows at a time (torch twins: `terms.l1` and `terms.*_in_torch`).

The regularizers run on one thread: they take 0.1 ms, less than waking a second thread does.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.memory import gather_flags, load_flags, pointer, store_columns
from ggavatar.jit.simd import LANES, exp, maximum, select, splat, sqrt, total
from ggavatar.jit.threads import run
from ggavatar.jit.vectors import columns_3, dot

CHUNK = 1 << 16
"""Numbers per task; sums are taken within each task, then over the tasks in order."""
PART = 1024
"""Rows whose costs are summed in single precision before the total in double precision."""
POSITION, LOG_SCALE = range(2)
"""Cost of a row: max(‖row‖ − threshold, 0), or ‖max(exp(row) − threshold, 0)‖."""


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


@inlined
def row_costs(kind, rows, visible, threshold, first, last):
    """Costs of sixteen rows, and factors and vectors whose product is the gradient; both 0 where hidden."""
    zero, one = np.float32(0), np.float32(1)
    x, y, z = columns_3(rows, first, last)
    slope = (splat(one), splat(one), splat(one))
    if kind == LOG_SCALE:
        x, y, z = exp(x), exp(y), exp(z)
        slope = (x, y, z)
        x, y, z = maximum(x - threshold, zero), maximum(y - threshold, zero), maximum(z - threshold, zero)
    free = threshold if kind == POSITION else zero
    length = sqrt(dot((x, y, z), (x, y, z)))
    costs = visible_lanes(visible, first, last) & (length > free)
    factor = select(costs, one / length, zero)
    return select(costs, length - free, zero), factor, (x * slope[0], y * slope[1], z * slope[2])


@inlined
def visible_lanes(visible, first, last):
    """Flags of sixteen rows; rows beyond `last` are not visible."""
    return load_flags(visible, first) if first + LANES <= last + 1 else gather_flags(visible, first, last)


@kernel
def regularizer_sum(kind, rows, visible, threshold):
    """Sum of the costs over the visible rows, and the number of visible rows."""
    total_cost, seen, last = 0.0, 0, visible.size - 1
    rows, visible = pointer(rows, 0), pointer(visible, 0)
    for begin in range(0, last + 1, PART):
        cost = splat(np.float32(0))
        for first in range(begin, min(begin + PART, last + 1), LANES):
            cost = cost + row_costs(kind, rows, visible, threshold, first, last)[0]
        total_cost += total(cost)
    for n in range(last + 1):
        seen += visible[n]
    return total_cost, seen


@kernel
def regularizer_gradient(kind, rows, visible, threshold, upstream, gradient):
    """Write `upstream` times the gradient of the sum; `gradient` has room for a multiple of sixteen rows."""
    last = visible.size - 1
    rows, visible, gradient = pointer(rows, 0), pointer(visible, 0), pointer(gradient, 0)
    for first in range(0, last + 1, LANES):
        _, factor, vector = row_costs(kind, rows, visible, threshold, first, last)
        factor = factor * upstream
        store_columns(gradient, first * 3, (factor * vector[0], factor * vector[1], factor * vector[2]))


def l1_sum(x: Float32[ndarray, " K"], y: Float32[ndarray, " K"], gradient: Float32[ndarray, " _"]) -> float:
    """Sum of |x − y|; `gradient`, unless empty, receives the signs."""
    parts = [slice(first, min(first + CHUNK, x.size)) for first in range(0, x.size, CHUNK)]
    sums = [0.0] * len(parts)

    def task(index: int) -> None:
        part = parts[index]
        sums[index] = absolute_sum(x[part], y[part], gradient[part])

    run(task, len(parts))
    return sum(sums)
