"""The canonical surface: a network of signed distance and albedo (PointAvatar, Sec. 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.points.canonical_blockwise import evaluate_surface
from ggavatar.points.canonical_reference import CanonicalConfig
from ggavatar.points.layers import NormedLinear, he_normal, weight_and_bias

ALBEDO_SHARPNESS = 10.0


class Surface(NamedTuple):
    """The network's outputs at points: signed distance, its gradient, and albedo in [0, 1]."""

    distance: Float[Tensor, " N"]
    gradient: Float[Tensor, "N 3"]
    albedo: Float[Tensor, "N 3"]


class CanonicalNetwork(nn.Module):
    """Network from positions to signed distance and albedo, initialized as a sphere.

    The gradient of the distance is computed in closed form in the same pass, so that losses on normals need no second
    derivatives from autograd.

    Args:
        config: Sizes.
        generator: Draws the initial weights.
        hidden_type: Data type of the hidden layers on a CPU; None is that of the positions.
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
        """The surface at points; no gradient flows into the points."""
        parameters = [tensor for layer in self.layers for tensor in weight_and_bias(layer)]
        values, gradient = evaluate_surface(x.detach(), self.config, parameters, self.hidden_type)
        return Surface(values[:, 0], gradient, torch.sigmoid(ALBEDO_SHARPNESS * values[:, 1:]))
