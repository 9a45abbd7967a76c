"""The canonical surface: one network gives signed distance, its gradient, and albedo (PointAvatar, Sec. 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.points.canonical_reference import CanonicalConfig
from ggavatar.points.layers import NormedLinear, affine, he_normal

ALBEDO_SHARPNESS = 10.0


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
