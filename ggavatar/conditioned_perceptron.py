"""A deep network over many rows that share one condition, at no more than its matrix products cost.

The condition's part of the first layer is one vector for all rows, and rows without an upstream gradient (Gaussians
that the image does not show) are left out of the backward pass. Both are exact.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.deform import linear


class ConditionedPerceptron(nn.Module):
    """A fully connected network with rectifiers, linear at its end, torch's default start.

    Its first layer sees a row's features and then the condition.

    Args:
        features: Numbers a row.
        conditions: Length of the condition.
        hidden: Width of the hidden layers.
        depth: How many hidden layers there are.
        outputs: Numbers a row at the end.
        generator: Draws the initial weights.
    """

    def __init__(
        self, features: int, conditions: int, hidden: int, depth: int, outputs: int, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.features = features
        widths = (features + conditions, *[hidden] * depth, outputs)
        self.layers = nn.ModuleList(linear(before, after, generator) for before, after in pairwise(widths))

    def forward(self, features: Float[Tensor, "N D"], condition: Float[Tensor, " C"]) -> Float[Tensor, "N R"]:
        """Outputs of all rows under one condition; no gradient flows into `features`."""
        first, *others = (cast(nn.Linear, layer) for layer in self.layers)
        shared = first.weight[:, self.features :] @ condition + first.bias
        parameters = [part for layer in others for part in (layer.weight, layer.bias)]
        return cast(Tensor, _Rows.apply(features, first.weight[:, : self.features], shared, *parameters))


class _Rows(torch.autograd.Function):
    """The layers over all rows; weight and bias alternate in `parameters`, the first layer's come first."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, *parameters: Tensor) -> Tensor:
        kept = [features]
        for at in range(0, len(parameters) - 2, 2):
            kept.append(torch.addmm(parameters[at + 1], kept[-1], parameters[at].T).relu_())
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*kept, *parameters[::2])
        return torch.addmm(parameters[-1], kept[-1], parameters[-2].T)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        half = len(ctx.saved_tensors) // 2
        kept, weights = ctx.saved_tensors[:half], ctx.saved_tensors[half:]
        active = upstream.any(-1).nonzero().squeeze(-1)
        gradient, found = upstream[active], []
        for number in reversed(range(half)):
            inputs = kept[number][active]
            found += [gradient.sum(0), gradient.T @ inputs]
            if number:
                gradient = (gradient @ weights[number]).mul_(inputs > 0)
        return None, *reversed(found)
