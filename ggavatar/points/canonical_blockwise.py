"""The canonical network block by block within the cache, with its backward pass in closed form.

The result is that of `canonical_reference.evaluate_surface_in_torch`, in float32 on a CPU. The backward pass visits
only points with an upstream gradient; points that are hidden in the image cost the forward pass only. Hidden layers can
be bfloat16; positions, outputs and the gradients of all parameters are float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from ggavatar.jit.bfloat16 import padded_indices
from ggavatar.points.canonical_reference import SKIP_SCALE, CanonicalConfig, evaluate_surface_in_torch
from ggavatar.points.layers import SHARPNESS, encode, softplus

BLOCK = 512
"""Points per block; the activations of a layer then take half a megabyte."""
GROUP = 128
"""The backward pass of a block processes a multiple of this number of points."""


def evaluate_surface(
    x: Float[Tensor, "N 3"], config: CanonicalConfig, parameters: list[Tensor], hidden_type: torch.dtype | None = None
) -> tuple[Float[Tensor, "N 4"], Float[Tensor, "N 3"]]:
    """`evaluate_surface_in_torch`, in blocks and with hidden layers of `hidden_type` if the tensors are on a CPU."""
    if x.device.type != "cpu":
        return evaluate_surface_in_torch(x, config, parameters)
    return _BlockwiseSurface.apply(hidden_type or x.dtype, x, config, *parameters)


class _BlockwiseSurface(torch.autograd.Function):
    """(positions, parameters) → (distance and raw albedo, gradient of the distance)."""

    @staticmethod
    def forward(
        ctx: Any, hidden_type: torch.dtype, x: Tensor, config: CanonicalConfig, *parameters: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Distance with raw albedo, and the distance's gradient, at every position, block by block."""
        values, gradient = x.new_empty(len(x), 4), torch.empty_like(x)
        keep = any(ctx.needs_input_grad)
        parameters = tuple(parameter.to(hidden_type) for parameter in parameters)
        ctx.config, ctx.kept = config, []
        for start in range(0, len(x), BLOCK):
            rows = slice(start, start + BLOCK)
            values[rows], gradient[rows], kept = _forward_block(x[rows], config, parameters, keep)
            ctx.kept.append(kept)
        ctx.save_for_backward(x, *parameters)
        return values, gradient

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_values: Tensor, to_gradient: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of the parameters alone: positions are constants, and those that nothing depends on are skipped."""
        x, *parameters = ctx.saved_tensors
        found = [torch.zeros_like(parameter, dtype=x.dtype) for parameter in parameters]
        matters = (to_values != 0).any(1) | (to_gradient != 0).any(1)
        for number, kept in enumerate(ctx.kept):
            start = number * BLOCK
            rows = padded_indices(matters[start : start + BLOCK], GROUP)
            if len(rows):
                states, pulls = ([tensor[rows] for tensor in tensors] for tensors in kept)
                own = x[start + rows], to_values[start + rows], to_gradient[start + rows]
                _backward_block(own, ctx.config, parameters, (states, pulls), found)
        return None, None, None, *found


Kept = tuple[list[Tensor], list[Tensor]]


def _forward_block(
    x: Tensor, config: CanonicalConfig, parameters: tuple[Tensor, ...], keep: bool
) -> tuple[Tensor, Tensor, Kept]:
    """The outputs of one block; with `keep` also the activations and the backpropagated gradients of every layer."""
    weights, biases = parameters[::2], parameters[1::2]
    encoded, slopes = _encode(x, config, parameters)
    state, states, derivatives, pulls = encoded, [encoded], [], []
    for index in range(config.hidden):
        if index and index == config.skip:
            state = torch.cat((state, encoded), dim=1).mul_(SKIP_SCALE)
            states[index] = state
        state, derivative = softplus(torch.addmm(biases[index], state, weights[index].T))
        states.append(state)
        derivatives.append(derivative)
    values = torch.addmm(biases[-1], state, weights[-1].T)
    pull, direct = weights[-1][:1].expand(len(x), -1), torch.zeros_like(encoded)
    for index in reversed(range(config.hidden)):
        pulls.append(pull)
        pull = (pull * derivatives[index]) @ weights[index]
        if index and index == config.skip:
            pull, direct = pull[:, : -encoded.shape[1]] * SKIP_SCALE, pull[:, -encoded.shape[1] :] * SKIP_SCALE
    gradient = ((pull + direct) * slopes).unflatten(1, (-1, 3)).sum(1)
    return values, gradient, (states, pulls[::-1]) if keep else ([], [])


def _backward_block(
    own: tuple[Tensor, Tensor, Tensor],
    config: CanonicalConfig,
    parameters: list[Tensor],
    kept: Kept,
    found: list[Tensor],
) -> None:
    """Add one block's contribution to the gradients of all parameters.

    The first loop differentiates the computation of the distance's gradient, from the position outwards; the second
    backpropagates through the layers. The derivative s of a layer's softplus couples the two by ds/dz = β s (1 − s).
    """
    x, to_values, to_gradient = own
    states, pulls = kept
    encoded, slopes = _encode(x, config, parameters)
    derivatives = [_derivative(states, index, config) for index in range(config.hidden)]
    weights = parameters[::2]
    to_encoded = (to_gradient[:, None] * slopes.unflatten(1, (-1, 3))).flatten(1).to(encoded)
    to_pull, links = to_encoded, []
    for index in range(config.hidden):
        if index and index == config.skip:
            to_pull = torch.cat((to_pull, to_encoded), dim=1).mul_(SKIP_SCALE)
        slope = derivatives[index]
        found[2 * index] += (pulls[index] * slope).T @ to_pull
        to_product = to_pull @ weights[index].T
        links.append((to_product * pulls[index]).mul_(slope).mul_(1 - slope).mul_(SHARPNESS))
        to_pull = to_product.mul_(slope)
    found[2 * config.hidden][0] += to_pull.sum(0)
    to_state = to_values.to(encoded)
    for index in reversed(range(config.hidden + 1)):
        if index < config.hidden:
            to_state = to_state.mul_(derivatives[index]).add_(links[index])
        found[2 * index] += to_state.T @ states[index]
        found[2 * index + 1] += to_state.sum(0)
        if index:
            to_state = to_state @ weights[index]
            if index == config.skip:
                to_state = to_state[:, : -encoded.shape[1]] * SKIP_SCALE


def _encode(x: Tensor, config: CanonicalConfig, parameters: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """The encoded positions in the data type of the layers, and the derivatives of the encoding."""
    encoded, slopes = encode(x, config.octaves)
    return encoded.to(parameters[0]), slopes


def _derivative(states: list[Tensor], index: int, config: CanonicalConfig) -> Tensor:
    """Derivative of the softplus of hidden layer `index`, from its output a: 1 − exp(−β a)."""
    state = states[index + 1]
    if index + 1 == config.skip:
        state = state[:, : config.width - states[0].shape[1]] / SKIP_SCALE
    return 1 - torch.exp(-SHARPNESS * state)
