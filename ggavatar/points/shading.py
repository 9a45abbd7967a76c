"""Color of points: albedo times a shading that depends on the normal only (PointAvatar, Sec. 3.4)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.networks.linear import seeded_linear
from ggavatar.points.layers import NormedLinear

WIDTH = 64


class ShadingNetwork(nn.Module):
    """Network from unit normals to shading in [0, 1] of each color channel; 0.5 is neutral."""

    def __init__(self, generator: torch.Generator) -> None:
        super().__init__()
        sizes = ((3, WIDTH), (WIDTH, WIDTH), (WIDTH, 3))
        drawn = [seeded_linear(inputs, outputs, generator) for inputs, outputs in sizes]
        self.layers = nn.ModuleList(NormedLinear(layer.weight.detach(), layer.bias.detach()) for layer in drawn)

    def forward(self, normals: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
        """Shading of surfaces with these normals, which are in camera axes."""
        first, second, last = self.layers
        return torch.sigmoid(last(torch.relu(second(torch.relu(first(normals))))))


def shaded(shading: Float[Tensor, "N 3"], albedo: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Color: twice the product, within [0, 1]."""
    return (2 * shading * albedo).clamp(0, 1)
