"""The canonical network: its closed-form gradient and its blockwise evaluation against float64 autograd."""

from __future__ import annotations

import dataclasses
import functools

import pytest
import torch
from torch import Tensor

from ggavatar.points.canonical import CanonicalNetwork
from ggavatar.points.canonical_blockwise import BLOCK, evaluate_surface
from ggavatar.points.canonical_reference import CanonicalConfig, evaluate_surface_in_torch
from ggavatar.points.layers import NormedLinear, encode, softplus

SMALL = CanonicalConfig(width=64, hidden=6, skip=3, octaves=2)


def parameters(config: CanonicalConfig, dtype: torch.dtype, shaken: float = 0.05) -> list[Tensor]:
    """Those of a network that is no sphere any more."""
    generator = torch.Generator().manual_seed(3)
    network = CanonicalNetwork(config, generator)
    tensors = [tensor.detach() for layer in network.layers for tensor in (layer.weight(), layer.bias)]
    return [
        (tensor + shaken * torch.randn(tensor.shape, generator=generator)).to(dtype).requires_grad_()
        for tensor in tensors
    ]


def positions(count: int, dtype: torch.dtype) -> Tensor:
    return (1.4 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) - 0.7).to(dtype)


@pytest.mark.parametrize("config", [SMALL, dataclasses.replace(SMALL, skip=0), CanonicalConfig()])
def test_the_gradient_of_the_distance_is_exact(config: CanonicalConfig) -> None:
    x, tensors = positions(40, torch.float64).requires_grad_(), parameters(config, torch.float64)
    values, gradient = evaluate_surface_in_torch(x, config, tensors)
    (expected,) = torch.autograd.grad(values[:, 0].sum(), x)
    assert torch.allclose(gradient, expected, atol=1e-10) and expected.norm(dim=1).min() > 1e-3


def loss_gradients(function: object, config: CanonicalConfig, dtype: torch.dtype, first: int) -> list[Tensor]:
    """Gradients of a random loss on distance, albedo and gradient of the first points, in float64."""
    x, tensors = positions(BLOCK + 90, dtype), parameters(config, dtype)
    values, gradient = function(x, config, tensors)  # type: ignore[operator]
    generator = torch.Generator().manual_seed(2)
    weights = torch.randn(len(x), 7, generator=generator).to(dtype)
    (torch.cat((values, gradient), dim=1) * weights)[:first].sum().backward()
    return [values.detach().double(), gradient.detach().double(), *(tensor.grad.double() for tensor in tensors)]


@pytest.mark.parametrize("config", [SMALL, dataclasses.replace(SMALL, skip=0)])
@pytest.mark.parametrize("first", [700, 5])
def test_evaluation_by_blocks_equals_the_plain_one(config: CanonicalConfig, first: int) -> None:
    expected = loss_gradients(evaluate_surface_in_torch, config, torch.float64, first)
    for dtype, slack in ((torch.float64, 1e-10), (torch.float32, 2e-4)):
        for ours, theirs in zip(loss_gradients(evaluate_surface, config, dtype, first), expected, strict=True):
            assert (ours - theirs).norm() <= slack * theirs.norm()


def test_hidden_layers_of_bfloat16_keep_two_digits() -> None:
    expected = loss_gradients(evaluate_surface_in_torch, SMALL, torch.float64, 700)
    fast = functools.partial(evaluate_surface, hidden_type=torch.bfloat16)
    found = loss_gradients(fast, SMALL, torch.float32, 700)
    for ours, theirs in zip(found, expected, strict=True):
        assert 1e-5 * theirs.norm() < (ours - theirs).norm() <= 0.1 * theirs.norm()


def test_it_starts_as_a_sphere() -> None:
    network = CanonicalNetwork(CanonicalConfig(), torch.Generator().manual_seed(0))
    directions = torch.nn.functional.normalize(positions(200, torch.float32), dim=1)
    inside, outside = network(0.3 * directions), network(0.9 * directions)
    assert (inside.distance < 0).all() and (outside.distance > 0).all()
    facing = torch.nn.functional.normalize(outside.gradient, dim=1)
    assert (facing * directions).sum(1).mean() > 0.9
    assert ((outside.albedo > 0) & (outside.albedo < 1)).all()


def test_albedo_is_ten_times_as_steep_as_a_logistic_function() -> None:
    network = CanonicalNetwork(CanonicalConfig(), torch.Generator().manual_seed(0))
    x = positions(9, torch.float32)
    values, _ = evaluate_surface_in_torch(x, network.config, parameters_of(network))
    assert torch.allclose(network(x).albedo, torch.sigmoid(10 * values[:, 1:]), atol=1e-5)


def parameters_of(network: CanonicalNetwork) -> list[Tensor]:
    return [tensor for layer in network.layers for tensor in (layer.weight(), layer.bias)]


def test_printed_sizes() -> None:
    network = CanonicalNetwork(CanonicalConfig(), torch.Generator().manual_seed(0))
    shapes = [tuple(layer.direction.shape) for layer in network.layers]
    assert shapes == [(256, 39), *[(256, 256)] * 2, (217, 256), *[(256, 256)] * 5, (4, 256)]
    assert torch.all(network.layers[-1].bias == -0.6)


def test_softplus_and_its_derivatives() -> None:
    z = torch.linspace(-0.4, 0.4, 41, dtype=torch.float64).requires_grad_()
    value, derivative = softplus(z)
    assert torch.allclose(value, torch.nn.functional.softplus(z, beta=100.0, threshold=1e9), atol=1e-12)
    (expected,) = torch.autograd.grad(torch.nn.functional.softplus(z, beta=100.0, threshold=1e9).sum(), z)
    assert torch.allclose(derivative, expected, atol=1e-12)
    assert torch.autograd.gradcheck(softplus, (z,))
    extreme, slopes = softplus(torch.tensor([-50.0, 50.0]))
    assert extreme.tolist() == [0.0, 50.0] and slopes.tolist() == [0.0, 1.0]


def test_encoding_has_two_per_octave_and_no_pi() -> None:
    x = torch.tensor([[0.3, -0.2, 0.7]], dtype=torch.float64)
    values, slopes = encode(x, 2)
    expected = [x, x.sin(), x.cos(), (2 * x).sin(), (2 * x).cos()]
    assert torch.allclose(values, torch.cat(expected, dim=1))
    jacobian = torch.autograd.functional.jacobian(lambda y: encode(y, 2)[0], x)[0, :, 0]
    assert torch.allclose(jacobian.sum(1)[None], slopes) and (jacobian != 0).sum() == 15


def test_weight_norm() -> None:
    layer = NormedLinear(torch.tensor([[3.0, 4.0]]), torch.tensor([1.0]))
    assert torch.allclose(layer(torch.tensor([1.0, 2.0])), torch.tensor([12.0]))
    with torch.no_grad():
        layer.direction.mul_(7)
        assert torch.allclose(layer(torch.tensor([1.0, 2.0])), torch.tensor([12.0]))
        layer.magnitude.mul_(2)
        assert torch.allclose(layer(torch.tensor([1.0, 2.0])), torch.tensor([23.0]))
