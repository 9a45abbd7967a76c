"""How canonical points move: learned blendshapes and skinning weights with their derivatives by position.

The networks give, at any canonical point, an offset to where the head model has it, a basis for expressions and pose
correctives, and weights of the joints (PointAvatar, Sec. 3.2). Normals need the Jacobian of the whole motion, so three
tangents, one for each direction, travel through the layers beside the values.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.points.layers import NormedLinear, affine, he_normal, softplus

WIDTH, LAYERS = 128, 4
TEMPERATURE = 20.0
"""Factor of the skinning logits (PointAvatar)."""


class Features(NamedTuple):
    """What no drive changes: last hidden layer and weights of the joints, with their derivatives along x, y and z.

    Without tangents of the layer all derivatives count as 0: normals then turn with the joints alone.
    """

    values: Float[Tensor, "N H"]
    tangents: Float[Tensor, "N 3 H"] | None
    weights: Float[Tensor, "N J"]
    weight_tangents: Float[Tensor, "N 3 J"]


class Motion(NamedTuple):
    """What moves points, and the derivative of each part along x, y and z of the canonical point.

    `offsets` lead to the head model's canonical shape, `correctives` are the blendshapes' sum, both in the unit of the
    points; `weights` of the joints sum to 1.
    """

    offsets: Float[Tensor, "N 3"]
    offset_tangents: Float[Tensor, "N 3 3"]
    correctives: Float[Tensor, "N 3"]
    corrective_tangents: Float[Tensor, "N 3 3"]
    weights: Float[Tensor, "N J"]
    weight_tangents: Float[Tensor, "N 3 J"]


class Bases(NamedTuple):
    """The head model as learned at some points: blendshapes (last axis: x, y, z), skinning weights, and offsets."""

    blendshapes: Float[Tensor, "N B 3"]
    weights: Float[Tensor, "N J"]
    offsets: Float[Tensor, "N 3"]


class PointDeformer(nn.Module):
    """Canonical position → offset, blendshapes and skinning weights; at first nothing moves and joints share evenly.

    Args:
        blendshapes: How many there are: pose correctives and expressions.
        joints: How many there are, the still one included.
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
        """The last hidden layer and the joints' weights at canonical points."""
        first, *others = self.trunk
        weight, bias = affine(first)
        values, slope = softplus(torch.addmm(bias, x, weight.T))
        tangents = slope[:, None] * weight.T
        for layer in others:
            values, tangents = _through(layer, values, tangents)
        return Features(values, tangents, *self._skinning(values, tangents))

    def features_alone(self, x: Float[Tensor, "N 3"]) -> Features:
        """As `features` without derivatives, at a quarter of the cost."""
        values = self._values(x)
        weights = self._weights(softplus(self.skinning_layer(values))[0])
        return Features(values, None, weights, weights.new_zeros(len(x), 3, weights.shape[1]))

    def motion(self, features: Features, coefficients: Float[Tensor, " B"]) -> Motion:
        """The motion for blendshape coefficients, which are contracted with the basis before any point sees it."""
        sums = torch.stack((torch.tensordot(coefficients, self.shape_weight[:-1], 1), self.shape_weight[-1]))
        biases = torch.stack((coefficients @ self.shape_bias[:-1], self.shape_bias[-1]))
        shapes = torch.addmm(biases.flatten(), features.values, sums.flatten(0, 1).T)
        if features.tangents is None:
            shape_tangents = shapes.new_zeros(len(shapes), 3, shapes.shape[1])
        else:
            shape_tangents = features.tangents @ sums.flatten(0, 1).T
        offsets, correctives = (shapes[:, 3:], shape_tangents[..., 3:]), (shapes[:, :3], shape_tangents[..., :3])
        return Motion(*offsets, *correctives, features.weights, features.weight_tangents)

    def bases(self, x: Float[Tensor, "N 3"]) -> Bases:
        """Blendshapes, weights and offsets themselves, at a few points."""
        values = self._values(x)
        shapes = torch.einsum("nh,bch->nbc", values, self.shape_weight) + self.shape_bias
        return Bases(shapes[:, :-1], self._weights(softplus(self.skinning_layer(values))[0]), shapes[:, -1])

    def _values(self, x: Tensor) -> Tensor:
        """The last hidden layer."""
        for layer in self.trunk:
            x = softplus(layer(x))[0]
        return x

    def _skinning(self, values: Tensor, tangents: Tensor) -> tuple[Tensor, Tensor]:
        """Weights of the joints, and their derivatives along x, y and z."""
        values, tangents = _through(self.skinning_layer, values, tangents)
        weights = self._weights(values)
        slopes = TEMPERATURE * (tangents @ self.skinning_weight.T)
        return weights, weights[:, None] * (slopes - (slopes * weights[:, None]).sum(-1, keepdim=True))

    def _weights(self, values: Tensor) -> Tensor:
        return torch.softmax(TEMPERATURE * torch.addmm(self.skinning_bias, values, self.skinning_weight.T), dim=-1)


def _through(layer: nn.Module, values: Tensor, tangents: Tensor) -> tuple[Tensor, Tensor]:
    """Values and tangents behind a layer and its softplus."""
    weight, bias = affine(layer)
    after, slope = softplus(torch.addmm(bias, values, weight.T))
    return after, slope[:, None] * (tangents @ weight.T)
