"""The Geometry Morph Adjuster: expression-driven offsets of Gaussians (GGAvatar Sec. 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.gaussians.offsets import GEOMETRY_ROWS, Offsets
from ggavatar.networks.fields import Field
from ggavatar.networks.linear import seeded_linear
from ggavatar.networks.linear_relu import layer_relu
from ggavatar.networks.mlp import field_perceptron


@dataclass(frozen=True)
class AdjusterConfig:
    """Sizes of the Geometry Morph Adjuster, none of which the paper states (docs/paper.md, A8)."""

    latent: int = 32
    """Length L of the latent vector f, the number of bases."""
    hidden: int = 64
    """Width of the two hidden layers of the basis network."""
    latent_hidden: int = 128
    """Width of the two hidden layers of the latent network."""
    rows: int = GEOMETRY_ROWS
    """Rows of a basis: `GEOMETRY_ROWS`, or `COLOR_ROWS` more (`ggavatar.gaussians.offsets`)."""


class BasisAdjuster(nn.Module):
    """Offsets W(x)·f(ψ, θ) from a field of bases and one small latent vector.

    The basis network ends in W = A h + c. Training never builds W: it contracts A and c with f first, the same product
    in another order, so that the cost does not depend on L. A and c start at zero, so the adjuster starts as the
    identity; f is not zero, so gradients reach A and c (docs/paper.md, A7).

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
        self.first = seeded_linear(field.width, config.hidden, generator)
        self.second = seeded_linear(config.hidden, config.hidden, generator)
        width = config.latent_hidden
        self.latent_network = nn.Sequential(
            seeded_linear(conditions, width, generator), nn.ReLU(),
            seeded_linear(width, width, generator), nn.ReLU(),
            seeded_linear(width, config.latent, generator),
        )  # fmt: skip
        self.last_weight = nn.Parameter(torch.zeros(config.rows, config.latent, config.hidden))
        self.last_bias = nn.Parameter(torch.zeros(config.rows, config.latent))

    def forward(self, x: Float[Tensor, "N 3"], condition: Float[Tensor, "*B C"]) -> Offsets:
        """Offsets at canonical positions `x` (m, no gradient); a batch of conditions shares one field lookup."""
        latent = self.latent(condition)
        weight, bias = self._contracted(latent)
        first, second = self.first, self.second
        last = weight.flatten(0, -2), bias.flatten()
        rows = field_perceptron(self.field, x, (first.weight, first.bias), (second.weight, second.bias), last)
        return Offsets(rows.unflatten(-1, bias.shape).movedim(0, -2))

    def latent(self, condition: Float[Tensor, "*B C"]) -> Float[Tensor, "*B L"]:
        """The latent vector f (Eq. 10)."""
        first, second, last = (layer for layer in self.latent_network if isinstance(layer, nn.Linear))
        return last(layer_relu(second, layer_relu(first, condition)))

    def latent_layers(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Weight and bias of every layer of the latent network; ReLU lies between them."""
        return tuple(
            (layer.weight.detach(), layer.bias.detach())
            for layer in self.latent_network
            if isinstance(layer, nn.Linear)
        )

    def hidden(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N H"]:
        """The last hidden layer h of the basis network; independent of the condition."""
        return layer_relu(self.second, layer_relu(self.first, self.field(x)))

    @torch.no_grad()
    def cache(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N H"]:
        """`hidden(x)` without gradients, to be reused for all frames: `offsets(hidden, latent(condition))`."""
        return self.hidden(x)

    def offsets(self, hidden: Float[Tensor, "N H"], latent: Float[Tensor, "*B L"]) -> Offsets:
        """The product W·f (Eq. 11) from hidden features and a latent vector."""
        weight, bias = self._contracted(latent)
        if latent.ndim == 1:
            return Offsets(torch.addmm(bias, hidden, weight.t()))
        return Offsets(hidden @ weight.transpose(-1, -2) + bias[..., None, :])

    def _contracted(self, latent: Float[Tensor, "*B L"]) -> tuple[Float[Tensor, "*B R H"], Float[Tensor, "*B R"]]:
        """A and c contracted with f."""
        bias = latent @ self.last_bias.T
        if latent.ndim == 1:  # without the copy of the weights that tensordot makes
            return torch.bmm(latent.expand(len(bias), 1, -1), self.last_weight).squeeze(1), bias
        return torch.tensordot(latent, self.last_weight, dims=([-1], [1])), bias

    def basis(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N R L"]:
        """W itself (Eq. 9), for export and tests; N × rows × L numbers."""
        return torch.einsum("nh,rlh->nrl", self.hidden(x), self.last_weight) + self.last_bias
