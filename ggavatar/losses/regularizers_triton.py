"""The regularizers of positions and scales, and their gradients, in Triton (torch twins: `ggavatar.losses.terms`)."""

from __future__ import annotations

from typing import Any, cast

import torch
import triton.language as tl
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import dot, load_3, product, scaled, store_3

BLOCK = 256
POSITION, LOG_SCALE = 0, 1
"""Cost of a row: max(‖row‖ − threshold, 0), or ‖max(exp(row) − threshold, 0)‖."""


@device_function
def _cost(rows_at, visible, row, alive, threshold, KIND: tl.constexpr):
    """Costs of rows, which rows are visible, and the derivatives of the costs."""
    at = load_3(rows_at, row, alive)
    seen = alive & (tl.load(visible + row, mask=alive, other=0) != 0)
    free = threshold
    slope = 1.0, 1.0, 1.0
    if KIND == 1:
        slope = tl.exp(at[0]), tl.exp(at[1]), tl.exp(at[2])
        at = (
            tl.maximum(slope[0] - threshold, 0.0),
            tl.maximum(slope[1] - threshold, 0.0),
            tl.maximum(slope[2] - threshold, 0.0),
        )
        free = 0.0
    length = tl.sqrt(dot(at, at))
    costs = seen & (length > free)
    direction = scaled(tl.where(costs, 1.0 / tl.where(costs, length, 1.0), 0.0), at)
    return tl.where(costs, length - free, 0.0), seen, product(direction, slope)


@device_kernel
def sum_costs(rows_at, visible, sums, rows, threshold, KIND: tl.constexpr, BLOCK: tl.constexpr):
    """Write the sum of the costs [N, 3] of a block, and how many of its rows are visible, to a row of [programs, 2]."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    cost, seen, _ = _cost(rows_at, visible, row, row < rows, threshold, KIND)
    tl.store(sums + 2 * tl.program_id(0), tl.sum(cost, axis=0))
    tl.store(sums + 2 * tl.program_id(0) + 1, tl.sum(tl.where(seen, 1.0, 0.0), axis=0))


@device_kernel
def finish_mean(sums, mean, programs, weight, BLOCK: tl.constexpr):
    """Write `weight` times the mean cost of the visible rows, and over their number, from the sums of blocks."""
    total, count = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    for first in range(0, programs, BLOCK):
        program = first + tl.arange(0, BLOCK)
        total += tl.load(sums + 2 * program, mask=program < programs, other=0.0)
        count += tl.load(sums + 2 * program + 1, mask=program < programs, other=0.0)
    inverse = weight / tl.maximum(tl.sum(count, axis=0), 1.0)
    tl.store(mean, tl.sum(total, axis=0) * inverse)
    tl.store(mean + 1, inverse)


@device_kernel
def differentiate_costs(
    rows_at, visible, mean, upstream, gradient, rows, threshold, KIND: tl.constexpr, BLOCK: tl.constexpr
):
    """Write the gradient [N, 3] of the rows, given that of the weighted mean."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    _, _, slope = _cost(rows_at, visible, row, alive, threshold, KIND)
    store_3(gradient, row, alive, scaled(tl.load(upstream) * tl.load(mean + 1), slope))


class _Regularizer(torch.autograd.Function):
    """Weighted mean cost of the visible rows (`kind`: `POSITION` or `LOG_SCALE`)."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, visible: Tensor, threshold: float, weight: float, kind: int) -> Tensor:
        """The mean, on the device."""
        values, visible = values.detach().contiguous(), visible.contiguous()
        programs = -(-len(values) // BLOCK)
        sums, mean = values.new_empty(programs, 2), values.new_empty(2)
        device_kernels.launch(
            sum_costs, programs, values, visible, sums, len(values), threshold, KIND=kind, BLOCK=BLOCK
        )
        device_kernels.launch(finish_mean, 1, sums, mean, programs, weight, BLOCK=256)
        ctx.save_for_backward(values, visible, mean)
        ctx.options = threshold, kind
        return mean[0]

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None, None]:
        """The gradient of the values."""
        values, visible, mean = ctx.saved_tensors
        threshold, kind = ctx.options
        gradient = torch.empty_like(values)
        device_kernels.launch(
            differentiate_costs, -(-len(values) // BLOCK), values, visible, mean, upstream, gradient,
            len(values), threshold, KIND=kind, BLOCK=BLOCK,
        )  # fmt: skip
        return gradient, None, None, None, None


def regularizer(values: Tensor, visible: Tensor, threshold: float, weight: float, kind: int) -> Tensor:
    """`weight` times the mean cost of the visible rows; 0, attached to the graph, if there is none."""
    return cast(Tensor, _Regularizer.apply(values, visible, threshold, weight, kind))
