"""Expression-driven offsets of Gaussians: the Geometry Morph Adjuster (GGAvatar Sec. 3.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import relu

from ggavatar.gaussians.offsets import Offsets, refine
from ggavatar.networks.fields import Field
from ggavatar.networks.mlp import field_perceptron

__all__ = ["COLOUR_ROWS", "GEOMETRY_ROWS", "AdjusterConfig", "BasisAdjuster", "Offsets", "refine"]

GEOMETRY_ROWS, COLOUR_ROWS = 10, 13
"""Rows of a basis: position 3, rotation 4 and log-scale 3; with color 3 more."""


@dataclass(frozen=True)
class AdjusterConfig:
    """Sizes of the Geometry Morph Adjuster; the paper states none of them (docs/paper.md, A8)."""

    latent: int = 32
    """Length L of the latent vector f, the number of bases."""
    hidden: int = 64
    """Width of the two hidden layers of the basis network."""
    latent_hidden: int = 128
    """Width of the two hidden layers of the latent network."""
    rows: int = GEOMETRY_ROWS
    """Rows of a basis: 10 for geometry, 13 with color."""


class BasisAdjuster(nn.Module):
    """Offsets W(x)·f(ψ, θ) from a field of bases and one small latent vector.

    The basis network ends in W = A h + c. Training never builds W: A and c are contracted with f first, which is the
    same product in another order, so that the cost does not depend on L. A and c start at zero, so the adjuster starts
    as the identity, while f is not zero and carries gradient into them (docs/paper.md, A7).

    Args:
        field: Features of canonical positions.
        conditions: Length C of the condition vector (expression and pose).
        config: Sizes.
        generator: Draws the initial weights.

    References:
        GGAvatar Eq. 9–11.
    """

    def __init__(
        self,
        field: Field,
        conditions: int,
        config: AdjusterConfig,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.config = config
        self.field = field
        self.first = linear(field.width, config.hidden, generator)
        self.second = linear(config.hidden, config.hidden, generator)
        width = config.latent_hidden
        self.latent_network = nn.Sequential(
            linear(conditions, width, generator), nn.ReLU(),
            linear(width, width, generator), nn.ReLU(),
            linear(width, config.latent, generator),
        )  # fmt: skip
        self.last_weight = nn.Parameter(torch.zeros(config.rows, config.latent, config.hidden))
        self.last_bias = nn.Parameter(torch.zeros(config.rows, config.latent))

    def forward(self, x: Float[Tensor, "N 3"], condition: Float[Tensor, "*B C"]) -> Offsets:
        """Offsets at canonical positions `x` (m, no gradient); a batch of conditions shares one look at the field."""
        latent = self.latent(condition)
        weight, bias = self._contracted(latent)
        first, second = self.first, self.second
        last = weight.flatten(0, -2), bias.flatten()
        rows = field_perceptron(self.field, x, (first.weight, first.bias), (second.weight, second.bias), last)
        return Offsets(rows.unflatten(-1, bias.shape).movedim(0, -2))

    def latent(self, condition: Float[Tensor, "*B C"]) -> Float[Tensor, "*B L"]:
        """The latent vector f (Eq. 10)."""
        return self.latent_network(condition)

    def hidden(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N H"]:
        """The last hidden layer h of the basis network; independent of the condition."""
        return relu(self.second(relu(self.first(self.field(x)))))

    @torch.no_grad()
    def cache(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N H"]:
        """`hidden(x)` to keep while nothing is trained: a frame then costs `offsets(kept, latent(condition))`."""
        return self.hidden(x)

    def offsets(self, hidden: Float[Tensor, "N H"], latent: Float[Tensor, "*B L"]) -> Offsets:
        """The product W·f (Eq. 11), with the last layer contracted with f first."""
        weight, bias = self._contracted(latent)
        return Offsets(hidden @ weight.transpose(-1, -2) + bias[..., None, :])

    def _contracted(self, latent: Float[Tensor, "*B L"]) -> tuple[Float[Tensor, "*B R H"], Float[Tensor, "*B R"]]:
        """A and c contracted with f."""
        return torch.tensordot(latent, self.last_weight, dims=([-1], [1])), latent @ self.last_bias.T

    def basis(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N R L"]:
        """W itself (Eq. 9), for export and tests; N × rows × L numbers."""
        return torch.einsum("nh,rlh->nrl", self.hidden(x), self.last_weight) + self.last_bias


def linear(inputs: int, outputs: int, generator: torch.Generator) -> nn.Linear:
    """A fully connected layer with torch's default distribution, drawn from `generator`."""
    layer = nn.utils.skip_init(nn.Linear, inputs, outputs)
    bound = 1 / math.sqrt(inputs)
    nn.init.uniform_(layer.weight, -bound, bound, generator=generator)
    nn.init.uniform_(layer.bias, -bound, bound, generator=generator)
    return layer
