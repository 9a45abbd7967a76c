"""The canonical surface: one network gives signed distance, its gradient, and albedo (PointAvatar, Sec. 3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.points.layers import NormedLinear, affine, encode, he_normal, softplus

SKIP_SCALE = 0.5**0.5
ALBEDO_SHARPNESS = 10.0


@dataclass(frozen=True)
class CanonicalConfig:
    """Sizes of the canonical network."""

    width: int = 256
    """Of the hidden layers."""
    hidden: int = 9
    """Hidden layers."""
    skip: int = 4
    """Layer that sees the encoded position again; 0 is none."""
    octaves: int = 6
    """Of the positional encoding."""
    radius: float = 0.6
    """Of the sphere that the network starts as, in its unit of length."""


class Surface(NamedTuple):
    """What the network says at points: signed distance, its gradient, and albedo in [0, 1]."""

    distance: Float[Tensor, " N"]
    gradient: Float[Tensor, "N 3"]
    albedo: Float[Tensor, "N 3"]


class CanonicalNetwork(nn.Module):
    """Position → signed distance and albedo; starts as a sphere.

    The gradient of the distance is found in the same sweep, backwards through the layers and in closed form, so that
    losses on normals are differentiated once like any other.

    Args:
        config: Sizes.
        generator: Draws the initial weights.
        hidden_type: Of the hidden layers on a CPU; the positions' own if not given.
    """

    def __init__(
        self, config: CanonicalConfig, generator: torch.Generator, hidden_type: torch.dtype | None = None
    ) -> None:
        super().__init__()
        self.config, self.hidden_type = config, hidden_type
        encoded = 3 + 6 * config.octaves
        widths = [encoded] + [config.width] * config.hidden
        layers = []
        for index in range(config.hidden):
            outputs = config.width - encoded if index + 1 == config.skip else config.width
            weight = he_normal(widths[index], outputs, generator)
            if index == 0:
                weight[:, 3:] = 0
            elif index == config.skip:
                weight[:, 3 - encoded :] = 0
            layers.append(NormedLinear(weight, torch.zeros(outputs)))
        last = (torch.pi / config.width) ** 0.5 + 1e-4 * torch.randn(4, config.width, generator=generator)
        layers.append(NormedLinear(last, torch.full((4,), -config.radius)))
        self.layers = nn.ModuleList(layers)

    def forward(self, x: Float[Tensor, "N 3"]) -> Surface:
        """The surface at points, which get no gradient."""
        from ggavatar.points.canonical_sweep import sweep  # imported late: it needs this module

        parameters = [tensor for layer in self.layers for tensor in affine(layer)]
        values, gradient = sweep(x.detach(), self.config, parameters, self.hidden_type)
        return Surface(values[:, 0], gradient, torch.sigmoid(ALBEDO_SHARPNESS * values[:, 1:]))


def sweep_in_torch(
    x: Float[Tensor, "N 3"], config: CanonicalConfig, parameters: list[Tensor]
) -> tuple[Float[Tensor, "N 4"], Float[Tensor, "N 3"]]:
    """Distance and raw albedo, and the gradient of the distance, differentiable in the parameters.

    Args:
        x: Positions.
        config: Sizes.
        parameters: Weight and bias of every layer, in order.
    """
    weights, biases = parameters[::2], parameters[1::2]
    encoded, slopes = encode(x, config.octaves)
    state, derivatives = encoded, []
    for index in range(config.hidden):
        if index and index == config.skip:
            state = torch.cat((state, encoded), dim=1) * SKIP_SCALE
        state, derivative = softplus(torch.addmm(biases[index], state, weights[index].T))
        derivatives.append(derivative)
    values = torch.addmm(biases[-1], state, weights[-1].T)
    pull, direct = weights[-1][:1].expand(len(x), -1), torch.zeros_like(encoded)
    for index in reversed(range(config.hidden)):
        pull = (pull * derivatives[index]) @ weights[index]
        if index and index == config.skip:
            pull, direct = pull[:, : -encoded.shape[1]] * SKIP_SCALE, pull[:, -encoded.shape[1] :] * SKIP_SCALE
    gradient = ((pull + direct) * slopes).unflatten(1, (-1, 3)).sum(1)
    return values, gradient
