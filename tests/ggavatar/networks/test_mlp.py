"""The fused network against float64 autograd, for widths that do not fill vectors and for rows without gradient.

Also covers `ggavatar/jit/matmul_tiles.py`, `ggavatar/networks/mlp_kernel.py`.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from ggavatar.networks.mlp import perceptron, perceptron_in_torch

SHAPES = [(200, 72, 64, 64, 10), (131, 63, 48, 33, 13), (65, 5, 16, 80, 26), (1, 3, 2, 1, 1), (2500, 18, 32, 32, 10)]
"""Rows, inputs, first and second hidden width, outputs."""


def values(shape: tuple[int, ...], dtype: torch.dtype) -> list[Tensor]:
    count, inputs, first, second, outputs = shape
    generator = torch.Generator().manual_seed(count)
    sizes = [(count, inputs), (first, inputs), (first,), (second, first), (second,), (outputs, second), (outputs,)]
    drawn = [torch.randn(*size, generator=generator, dtype=torch.float64) for size in sizes]
    return [(value / value.shape[-1] ** 0.5).to(dtype).requires_grad_() for value in drawn]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("every", [1, 3])
def test_equals_float64_autograd(shape: tuple[int, ...], every: int) -> None:
    ours, wide = values(shape, torch.float32), values(shape, torch.float64)
    upstream = torch.zeros(shape[0], shape[-1])
    upstream[::every] = torch.randn(upstream[::every].shape, generator=torch.Generator().manual_seed(1))
    result = perceptron(ours[0], *(tuple(ours[at : at + 2]) for at in (1, 3, 5)))
    expected = perceptron_in_torch(wide[0], *(tuple(wide[at : at + 2]) for at in (1, 3, 5)))
    result.backward(upstream)
    expected.backward(upstream.double())
    assert (result - expected).norm() / expected.norm() < 1e-6
    for value, reference in zip(ours, wide, strict=True):
        assert value.grad is not None and reference.grad is not None
        assert value.grad.shape == value.shape
        assert (value.grad - reference.grad).norm() <= 3e-6 * reference.grad.norm() + 1e-12


def test_no_gradient_wanted_keeps_nothing() -> None:
    parts = [value.detach() for value in values(SHAPES[0], torch.float32)]
    assert not perceptron(parts[0], *(tuple(parts[at : at + 2]) for at in (1, 3, 5))).requires_grad
