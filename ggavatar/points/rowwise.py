"""Row-wise functions evaluated block by block, with a backward pass over the rows that have a gradient only.

Activations of a block stay in the cache. Most points are hidden in an image, and their colors have no gradient. The
forward pass stores no activations; the backward pass recomputes them for the rows whose outputs have a gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

BLOCK, LARGE_BLOCK = 512, 1 << 16
"""Rows per block on a CPU (limited by its cache) and on other devices (limited by their memory)."""

RowFunction = Callable[[Sequence[Tensor], Sequence[Tensor]], tuple[Tensor, ...]]


def rowwise(
    function: RowFunction, rows: Sequence[Tensor], shared: Sequence[Tensor], parameters: Sequence[Tensor]
) -> tuple[Tensor, ...]:
    """The outputs of `function(rows, shared)`, differentiable in rows, shared tensors and parameters.

    Args:
        function: Returns tensors whose row k depends on row k of the inputs only. Besides its arguments it may use
            `parameters`, but no other tensor that requires a gradient.
        rows: Tensors of equal length.
        shared: Tensors that are the same for all rows.
        parameters: Leaf tensors that `function` uses without receiving them as arguments.
    """
    return tuple(_Rowwise.apply(function, len(rows), len(shared), *rows, *shared, *parameters))


class _Rowwise(torch.autograd.Function):
    """(rows, shared, parameters) → outputs."""

    @staticmethod
    def forward(ctx: Any, function: RowFunction, rows: int, shared: int, *tensors: Tensor) -> tuple[Tensor, ...]:
        ctx.function, ctx.rows, ctx.shared = function, rows, shared
        ctx.save_for_backward(*tensors)
        blocks = []
        size = _block_size(tensors[0])
        for start in range(0, max(len(tensors[0]), 1), size):
            part = [tensor[start : start + size] for tensor in tensors[:rows]]
            blocks.append(function(part, tensors[rows : rows + shared]))
        return tuple(torch.cat(parts) for parts in zip(*blocks, strict=True))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        tensors, needed = ctx.saved_tensors, ctx.needs_input_grad[3:]
        found = [torch.zeros_like(tensor) if wanted else None for tensor, wanted in zip(tensors, needed, strict=True)]
        for index in _rows_with_gradient(upstream).split(_block_size(tensors[0])):
            _block_backward(ctx, tensors, needed, (index, [gradient[index] for gradient in upstream]), found)
        return None, None, None, *found


def _rows_with_gradient(upstream: Sequence[Tensor]) -> Tensor:
    """Indices of the rows that have a gradient; on CUDA of all rows, because the host would wait to count them."""
    if upstream[0].device.type == "cuda":
        return torch.arange(len(upstream[0]), device=upstream[0].device)
    matters = torch.stack([(gradient.flatten(1) != 0).any(1) for gradient in upstream]).any(0)
    return torch.nonzero(matters)[:, 0]


def _block_size(rows: Tensor) -> int:
    return BLOCK if rows.device.type == "cpu" else LARGE_BLOCK


def _block_backward(
    ctx: Any,
    tensors: Sequence[Tensor],
    needed: Sequence[bool],
    wanted: tuple[Tensor, list[Tensor]],
    found: list[Tensor | None],
) -> None:
    """Add the contribution of some rows to the gradients."""
    index, upstream = wanted
    count = ctx.rows + ctx.shared
    with torch.enable_grad():
        own = [tensor[index] if place < ctx.rows else tensor for place, tensor in enumerate(tensors[:count])]
        own = [tensor.detach().requires_grad_(need) for tensor, need in zip(own, needed, strict=False)]
        outputs = ctx.function(own[: ctx.rows], own[ctx.rows :])
    leaves = [*own, *tensors[count:]]
    places = [place for place, need in enumerate(needed) if need]
    gradients = torch.autograd.grad(outputs, [leaves[place] for place in places], upstream, allow_unused=True)
    for place, gradient in zip(places, gradients, strict=True):
        target = found[place]
        if gradient is not None and target is not None:
            if place < ctx.rows:
                target[index] = gradient
            else:
                target += gradient
