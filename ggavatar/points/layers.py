"""Layers of PointAvatar's networks: weight normalization, a sharp softplus, and positional encoding."""

from __future__ import annotations

from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

SHARPNESS = 100.0
"""β of the softplus: log(1 + exp(β z)) / β, nearly a rectifier but smooth (PointAvatar)."""


class NormedLinear(nn.Module):
    """A fully connected layer whose weight rows are magnitude · direction / ‖direction‖ (Salimans & Kingma 2016)."""

    def __init__(self, weight: Float[Tensor, "O I"], bias: Float[Tensor, " O"]) -> None:
        """A layer with this initial weight and bias."""
        super().__init__()
        self.direction = nn.Parameter(weight)
        self.magnitude = nn.Parameter(weight.norm(dim=1, keepdim=True))
        self.bias = nn.Parameter(bias)

    def weight(self) -> Float[Tensor, "O I"]:
        """The weight matrix: magnitude times normalized direction."""
        return self.direction * (self.magnitude / self.direction.norm(dim=1, keepdim=True))

    def forward(self, x: Float[Tensor, "*B I"]) -> Float[Tensor, "*B O"]:
        """W x + b."""
        return torch.nn.functional.linear(x, self.weight(), self.bias)


def weight_and_bias(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Weight matrix and bias of a module that is a `NormedLinear`."""
    assert isinstance(layer, NormedLinear)
    return layer.weight(), layer.bias


def he_normal(inputs: int, outputs: int, generator: torch.Generator) -> Float[Tensor, "O I"]:
    """Normal weights with deviation √(2 / outputs), as in geometric initialization (Atzmon & Lipman 2020)."""
    return torch.randn(outputs, inputs, generator=generator) * (2 / outputs) ** 0.5


def softplus(z: Tensor) -> tuple[Tensor, Tensor]:
    """The sharp softplus and its derivative; both are differentiable once."""
    return cast(tuple[Tensor, Tensor], _Softplus.apply(z))


class _Softplus(torch.autograd.Function):
    """Value and derivative from one exponential, twice as fast as torch's softplus."""

    @staticmethod
    def forward(ctx: Any, z: Tensor) -> tuple[Tensor, Tensor]:
        derivative = torch.sigmoid(SHARPNESS * z)
        larger = torch.maximum(derivative, 1 - derivative)  # its logarithm is accurate for either sign of z
        ctx.save_for_backward(derivative)
        return z.relu() - larger.log() / SHARPNESS, derivative

    @staticmethod
    def backward(ctx: Any, to_value: Tensor, to_derivative: Tensor) -> Tensor:
        (derivative,) = ctx.saved_tensors
        return derivative * (to_value + SHARPNESS * (1 - derivative) * to_derivative)


def encode(x: Float[Tensor, "N 3"], octaves: int) -> tuple[Float[Tensor, "N D"], Float[Tensor, "N D"]]:
    """x, then sin(2ᵏ x) and cos(2ᵏ x) for every octave, and the derivative of each entry by its coordinate."""
    values, slopes = [x], [torch.ones_like(x)]
    for octave in range(octaves):
        factor = 2.0**octave
        sine, cosine = torch.sin(factor * x), torch.cos(factor * x)
        values += [sine, cosine]
        slopes += [factor * cosine, -factor * sine]
    return torch.cat(values, dim=1), torch.cat(slopes, dim=1)
