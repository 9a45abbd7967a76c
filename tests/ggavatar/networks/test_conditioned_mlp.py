"""The network over rows with one condition against the plain network on rows with the condition repeated.

Also covers `ggavatar/networks/linear.py`.
"""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from torch import Tensor, nn

from ggavatar.networks.conditioned_mlp import ConditionedPerceptron


def plain(network: ConditionedPerceptron, features: Tensor, condition: Tensor) -> Tensor:
    """Every layer on every row, by torch's own modules and derivatives."""
    rows = torch.cat((features, condition.expand(len(features), -1)), dim=1)
    for layer in network.layers[:-1]:
        rows = torch.relu(layer(rows))
    return network.layers[-1](rows)


@pytest.mark.parametrize("depth", [1, 2, 6])
def test_values_and_gradients_equal_the_plain_network(depth: int) -> None:
    generator = torch.Generator().manual_seed(depth)
    network = ConditionedPerceptron(7, 5, 16, depth, 10, generator).double()
    features = torch.randn(30, 7, generator=generator).double()
    condition = torch.randn(5, generator=generator).double().requires_grad_()
    upstream = torch.randn(30, 10, generator=generator).double()
    upstream[::4] = 0  # rows that no pixel shows
    wanted = [condition, *network.parameters()]
    ours, theirs = (call(features, condition) for call in (network, lambda *given: plain(network, *given)))
    assert torch.allclose(ours, theirs, atol=1e-12)
    gradients = (torch.autograd.grad(result, wanted, upstream) for result in (ours, theirs))
    for one, other in zip(*gradients, strict=True):
        assert other.abs().max() > 0 and torch.allclose(one, other, atol=1e-12)


def test_no_row_with_a_gradient_gives_zeros() -> None:
    network = ConditionedPerceptron(3, 2, 8, 2, 4, torch.Generator().manual_seed(0))
    network(torch.ones(5, 3), torch.ones(2)).backward(torch.zeros(5, 4))
    assert all(parameter.grad is not None and not parameter.grad.any() for parameter in network.parameters())


def test_start_is_torchs_and_repeats() -> None:
    """Uniform in ±1/√inputs (He et al. 2015 with a = √5), weights and biases."""
    one, other = (ConditionedPerceptron(51, 120, 256, 6, 10, torch.Generator().manual_seed(3)) for _ in range(2))
    widths = (171, *[256] * 6, 10)
    assert len(one.layers) == 7 and all(isinstance(layer, nn.Linear) for layer in one.layers)
    for layer, (before, after), twin in zip(one.layers, pairwise(widths), other.layers, strict=True):
        assert layer.weight.shape == (after, before) and torch.equal(layer.weight, twin.weight)
        bound = before**-0.5
        assert 0.98 * bound < layer.weight.abs().max() <= bound and layer.bias.abs().max() <= bound
        assert layer.weight.std().item() == pytest.approx(bound / 3**0.5, rel=0.03)


def test_hidden_layers_of_bfloat16_are_those_of_float32_to_their_precision() -> None:
    exact, fast = (
        ConditionedPerceptron(51, 120, 64, 4, 10, torch.Generator().manual_seed(3), kind)
        for kind in (None, torch.bfloat16)
    )
    generator = torch.Generator().manual_seed(4)
    features, condition = torch.randn(300, 51, generator=generator), torch.randn(120, generator=generator)
    weights = torch.randn(300, 10, generator=generator)
    for network in (exact, fast):
        (network(features, condition) * weights).sum().backward()
    out, other = (network(features, condition).detach() for network in (exact, fast))
    assert other.dtype == torch.float32 and 1e-6 < float((other - out).norm() / out.norm()) < 0.01
    for one, two in zip(exact.parameters(), fast.parameters(), strict=True):
        assert one.grad is not None and two.grad is not None and two.grad.dtype == torch.float32
        assert float((two.grad - one.grad).norm() / one.grad.norm()) < 0.1  # rectifiers near zero flip
