"""A multilayer perceptron over many rows that share one condition vector.

The condition's part of the first layer is computed once for all rows, and rows without an upstream gradient (Gaussians
that are not visible) are skipped in the backward pass; both are exact. Hidden layers can be bfloat16; parameters and
outputs are float32.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.jit.bfloat16 import padded_indices
from ggavatar.networks.linear import seeded_linear

GROUP = 1024
"""The backward pass processes a multiple of this number of rows."""


class ConditionedPerceptron(nn.Module):
    """A fully connected network with ReLU, a linear output and torch's default initialization.

    The input of its first layer is a row's features followed by the condition.

    Args:
        features: Features per row.
        conditions: Length of the condition vector.
        hidden: Width of the hidden layers.
        depth: Number of hidden layers.
        outputs: Outputs per row.
        generator: Draws the initial weights.
        hidden_type: Data type of the hidden layers; None is that of the parameters.
    """

    def __init__(
        self,
        features: int,
        conditions: int,
        hidden: int,
        depth: int,
        outputs: int,
        generator: torch.Generator,
        hidden_type: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.features, self.hidden_type = features, hidden_type
        widths = (features + conditions, *[hidden] * depth, outputs)
        self.layers = nn.ModuleList(seeded_linear(before, after, generator) for before, after in pairwise(widths))

    def forward(self, features: Float[Tensor, "N D"], condition: Float[Tensor, " C"]) -> Float[Tensor, "N R"]:
        """Outputs of all rows under one condition; no gradient flows into `features`."""
        first, *others = (cast(nn.Linear, layer) for layer in self.layers)
        shared = first.weight[:, self.features :] @ condition + first.bias
        parameters = [part for layer in others for part in (layer.weight, layer.bias)]
        hidden_type = self.hidden_type or features.dtype
        return cast(Tensor, _Rows.apply(hidden_type, features, first.weight[:, : self.features], shared, *parameters))


class _Rows(torch.autograd.Function):
    """The layers over all rows; `parameters` holds weight and bias of each layer in turn."""

    @staticmethod
    def forward(ctx: Any, hidden_type: torch.dtype, features: Tensor, *parameters: Tensor) -> Tensor:
        *hidden, last_weight, last_bias = (
            *(parameter.to(hidden_type) for parameter in parameters[:-2]), *parameters[-2:]
        )  # fmt: skip
        kept = [features.to(hidden_type)]
        for weight, bias in zip(hidden[::2], hidden[1::2], strict=True):
            kept.append(torch.addmm(bias, kept[-1], weight.T).relu_())
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*kept, *hidden[::2], last_weight)
        return torch.addmm(last_bias, kept[-1].to(last_weight), last_weight.T)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        half = len(ctx.saved_tensors) // 2
        kept, weights = ctx.saved_tensors[:half], ctx.saved_tensors[half:]
        active = padded_indices(upstream.any(-1), GROUP)
        gradient, found = upstream[active], []
        for number in reversed(range(half)):
            inputs = kept[number][active]
            weight = weights[number]
            found += [gradient.sum(0), gradient.T @ inputs.to(weight)]
            if number:
                gradient = (gradient @ weight).to(inputs.dtype).mul_(inputs > 0)
        return None, None, *(part.to(upstream) for part in reversed(found))
