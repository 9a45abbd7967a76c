"""Deformation of canonical points: learned blendshapes and skinning weights, and their derivatives in position.

At any canonical point the network gives an offset to the head model's canonical shape, a basis for expressions and pose
correctives, and skinning weights (PointAvatar, Sec. 3.2). Normals need the Jacobian of the whole deformation, so three
tangents, one per direction, are propagated through the layers with the values (forward-mode differentiation).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.points.layers import NormedLinear, he_normal, softplus, weight_and_bias

WIDTH, LAYERS = 128, 4
TEMPERATURE = 20.0
"""Factor on the skinning logits (PointAvatar)."""


class Features(NamedTuple):
    """Drive-independent features: last hidden layer and skinning weights, with derivatives along x, y and z.

    If `tangents` is None, all derivatives are 0 and normals rotate with the joints only.
    """

    values: Float[Tensor, "N H"]
    tangents: Float[Tensor, "N 3 H"] | None
    weights: Float[Tensor, "N J"]
    weight_tangents: Float[Tensor, "N 3 J"]


class PointDeformation(NamedTuple):
    """Inputs of skinning at points, and their derivatives along x, y and z of the canonical point.

    `offsets` lead to the head model's canonical shape and `correctives` are the sum of the blendshapes, both in the
    unit of the points; the skinning `weights` sum to 1.
    """

    offsets: Float[Tensor, "N 3"]
    offset_tangents: Float[Tensor, "N 3 3"]
    correctives: Float[Tensor, "N 3"]
    corrective_tangents: Float[Tensor, "N 3 3"]
    weights: Float[Tensor, "N J"]
    weight_tangents: Float[Tensor, "N 3 J"]


class Bases(NamedTuple):
    """Learned blendshapes (last axis x, y, z), skinning weights and offsets at points."""

    blendshapes: Float[Tensor, "N B 3"]
    weights: Float[Tensor, "N J"]
    offsets: Float[Tensor, "N 3"]


class PointDeformer(nn.Module):
    """Network from canonical positions to offsets, blendshapes and skinning weights.

    Initially offsets and blendshapes are zero and all skinning weights are equal.

    Args:
        blendshapes: Number of blendshapes: pose correctives and expressions.
        joints: Number of joints, including the static one.
        generator: Draws the initial weights.
    """

    def __init__(self, blendshapes: int, joints: int, generator: torch.Generator) -> None:
        super().__init__()
        inputs = [3] + [WIDTH] * (LAYERS - 1)
        layers = (NormedLinear(he_normal(count, WIDTH, generator), torch.zeros(WIDTH)) for count in inputs)
        self.trunk = nn.ModuleList(layers)
        self.skinning_layer = NormedLinear(he_normal(WIDTH, WIDTH, generator), torch.zeros(WIDTH))
        self.shape_weight = nn.Parameter(torch.zeros(blendshapes + 1, 3, WIDTH))
        self.shape_bias = nn.Parameter(torch.zeros(blendshapes + 1, 3))
        self.skinning_weight = nn.Parameter(torch.zeros(joints, WIDTH))
        self.skinning_bias = nn.Parameter(torch.zeros(joints))

    def features(self, x: Float[Tensor, "N 3"]) -> Features:
        """The last hidden layer and the skinning weights at canonical points, with derivatives."""
        first, *others = self.trunk
        weight, bias = weight_and_bias(first)
        values, slope = softplus(torch.addmm(bias, x, weight.T))
        tangents = slope[:, None] * weight.T
        for layer in others:
            values, tangents = _layer_with_tangents(layer, values, tangents)
        return Features(values, tangents, *self._skinning(values, tangents))

    def features_without_tangents(self, x: Float[Tensor, "N 3"]) -> Features:
        """`features` without derivatives, at a quarter of the cost."""
        values = self._values(x)
        weights = self._weights(softplus(self.skinning_layer(values))[0])
        return Features(values, None, weights, weights.new_zeros(len(x), 3, weights.shape[1]))

    def deformation(self, features: Features, coefficients: Float[Tensor, " B"]) -> PointDeformation:
        """The deformation for blendshape coefficients; they are contracted with the basis once for all points."""
        sums = torch.stack((torch.tensordot(coefficients, self.shape_weight[:-1], 1), self.shape_weight[-1]))
        biases = torch.stack((coefficients @ self.shape_bias[:-1], self.shape_bias[-1]))
        shapes = torch.addmm(biases.flatten(), features.values, sums.flatten(0, 1).T)
        if features.tangents is None:
            shape_tangents = shapes.new_zeros(len(shapes), 3, shapes.shape[1])
        else:
            shape_tangents = features.tangents @ sums.flatten(0, 1).T
        offsets, correctives = (shapes[:, 3:], shape_tangents[..., 3:]), (shapes[:, :3], shape_tangents[..., :3])
        return PointDeformation(*offsets, *correctives, features.weights, features.weight_tangents)

    def bases(self, x: Float[Tensor, "N 3"]) -> Bases:
        """Blendshapes, skinning weights and offsets at a few points."""
        values = self._values(x)
        shapes = torch.einsum("nh,bch->nbc", values, self.shape_weight) + self.shape_bias
        return Bases(shapes[:, :-1], self._weights(softplus(self.skinning_layer(values))[0]), shapes[:, -1])

    def _values(self, x: Tensor) -> Tensor:
        """The last hidden layer."""
        for layer in self.trunk:
            x = softplus(layer(x))[0]
        return x

    def _skinning(self, values: Tensor, tangents: Tensor) -> tuple[Tensor, Tensor]:
        """Skinning weights, and their derivatives along x, y and z."""
        values, tangents = _layer_with_tangents(self.skinning_layer, values, tangents)
        weights = self._weights(values)
        slopes = TEMPERATURE * (tangents @ self.skinning_weight.T)
        return weights, weights[:, None] * (slopes - (slopes * weights[:, None]).sum(-1, keepdim=True))

    def _weights(self, values: Tensor) -> Tensor:
        return torch.softmax(TEMPERATURE * torch.addmm(self.skinning_bias, values, self.skinning_weight.T), dim=-1)


def _layer_with_tangents(layer: nn.Module, values: Tensor, tangents: Tensor) -> tuple[Tensor, Tensor]:
    """Values and tangents after a layer and its softplus."""
    weight, bias = weight_and_bias(layer)
    after, slope = softplus(torch.addmm(bias, values, weight.T))
    return after, slope[:, None] * (tangents @ weight.T)
