"""The fused linear layer with ReLU against torch in float64, with all gradients."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import linear, relu

from ggavatar.networks.linear_relu import fused_linear_relu, linear_relu


@pytest.mark.parametrize("shape", [(7,), (5, 7), (2, 3, 7)])
def test_values_and_gradients(shape: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(0)
    values = [torch.randn(*each, generator=generator, dtype=torch.float64) for each in (shape, (4, 7), (4,))]
    found, expected = ([value.clone().requires_grad_() for value in values] for _ in range(2))
    result, reference = fused_linear_relu(*found), relu(linear(*expected))
    torch.testing.assert_close(result, reference, atol=1e-14, rtol=0)
    assert (reference == 0).any() and (reference > 0).any()
    upstream = torch.randn(reference.shape, generator=generator, dtype=torch.float64)
    for total in (result, reference):
        (total * upstream).sum().backward()
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one.grad, other.grad, atol=1e-14, rtol=0)


def test_a_cpu_computes_what_torch_does() -> None:
    x, weight, bias = torch.randn(50, 7), torch.randn(4, 7), torch.randn(4)
    assert torch.equal(linear_relu(x, weight, bias), relu(linear(x, weight, bias)))
