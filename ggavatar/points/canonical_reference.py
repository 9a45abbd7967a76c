"""The canonical network in plain torch, and its configuration."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.points.layers import encode, softplus

SKIP_SCALE = 0.5**0.5


@dataclass(frozen=True)
class CanonicalConfig:
    """Sizes of the canonical network."""

    width: int = 256
    """Width of the hidden layers."""
    hidden: int = 9
    """Number of hidden layers."""
    skip: int = 4
    """Index of the hidden layer that receives the encoded position again; 0 is none."""
    octaves: int = 6
    """Octaves of the positional encoding."""
    radius: float = 0.6
    """Radius of the initial sphere, in the unit of the points."""


def evaluate_surface_in_torch(
    x: Float[Tensor, "N 3"], config: CanonicalConfig, parameters: list[Tensor]
) -> tuple[Float[Tensor, "N 4"], Float[Tensor, "N 3"]]:
    """Distance and raw albedo [N, 4], and the gradient of the distance, differentiable in the parameters.

    Args:
        x: Positions, in the unit of the points.
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
