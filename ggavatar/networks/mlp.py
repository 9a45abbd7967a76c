"""A perceptron with two hidden ReLU layers over many rows, alone or on the features of a hash tri-plane."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import linear

from ggavatar.jit.dispatch import compiled_for
from ggavatar.networks.fields import Field, HashTriplane, kernel_layout, kernel_points
from ggavatar.networks.linear_relu import linear_relu

Layer = tuple[Tensor, Tensor]
"""Weight [outputs, inputs] and bias of a linear layer."""


def perceptron(features: Float[Tensor, "N D"], first: Layer, second: Layer, last: Layer) -> Float[Tensor, "N R"]:
    """Last · relu(second · relu(first · features)), differentiable in all arguments."""
    if compiled_for(features, *first, *second, *last):
        return cast(Tensor, _Perceptron.apply(features, *first, *second, *last))
    return perceptron_in_torch(features, first, second, last)


def field_perceptron(
    field: Field, x: Float[Tensor, "N 3"], first: Layer, second: Layer, last: Layer
) -> Float[Tensor, "N R"]:
    """`perceptron` of a field's features at `x` (m); the backward pass skips rows without gradient."""
    if isinstance(field, HashTriplane) and field.compiled_at(x) and compiled_for(*first, *second, *last):
        points = kernel_points(field.box, x)
        return cast(Tensor, _FieldPerceptron.apply(points, field.tables, field.levels, *first, *second, *last))
    return perceptron(field(x), first, second, last)


def perceptron_in_torch(
    features: Float[Tensor, "N D"], first: Layer, second: Layer, last: Layer
) -> Float[Tensor, "N R"]:
    """`perceptron` in plain torch: any dtype and device."""
    return linear(linear_relu(linear_relu(features, *first), *second), *last)


class _Perceptron(torch.autograd.Function):
    """The compiled kernels of `ggavatar.networks.mlp_kernel`."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, *parameters: Tensor) -> Tensor:
        return _forward(ctx, features.detach().contiguous(), parameters)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, ...]:
        rows, to_features, to_parameters = _backward(ctx, upstream)
        scattered = torch.zeros(len(upstream), to_features.shape[1])
        scattered[torch.from_numpy(rows)] = torch.from_numpy(to_features)
        return scattered, *to_parameters


class _FieldPerceptron(torch.autograd.Function):
    """Lookup (`triplane_kernel`) and perceptron (`mlp_kernel`); backward skips rows without gradient in both."""

    @staticmethod
    def forward(ctx: Any, points: Any, tables: Tensor, levels: tuple[Any, ...], *parameters: Tensor) -> Tensor:
        from ggavatar.networks import triplane_kernel

        ctx.points, ctx.layout, ctx.shape = points, kernel_layout(levels), tables.shape
        features = torch.empty(points.shape[1], len(ctx.layout.scale) * triplane_kernel.FEATURES)
        triplane_kernel.look_up(ctx.points, tables.detach().numpy(), ctx.layout, features.numpy())
        return _forward(ctx, features, parameters)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        from ggavatar.networks import triplane_kernel

        rows, to_features, to_parameters = _backward(ctx, upstream)
        to_tables = torch.zeros(ctx.shape)
        triplane_kernel.backward(np.take(ctx.points, rows, axis=1), to_features, ctx.layout, to_tables.numpy())
        return None, to_tables, None, *to_parameters


def _forward(ctx: Any, features: Tensor, parameters: tuple[Tensor, ...]) -> Tensor:
    from ggavatar.networks import mlp_kernel as kernels

    arrays = [parameter.detach().numpy() for parameter in parameters]
    ctx.layers = tuple(kernels.pack(*arrays[at : at + 2]) for at in (0, 2, 4))
    room = len(features) if any(ctx.needs_input_grad) else 0
    kept = torch.empty(room * ctx.layers[0].outputs), torch.empty(room * ctx.layers[1].outputs)
    result = torch.empty(len(features), ctx.layers[2].outputs)
    kernels.forward(_flat(features), ctx.layers, (_flat(kept[0]), _flat(kept[1])), _flat(result))
    ctx.save_for_backward(features, *kept)
    return result


def _backward(ctx: Any, upstream: Tensor) -> tuple[Int64[ndarray, " A"], Float32[ndarray, "A D"], list[Tensor]]:
    """Indices of the rows with a gradient, gradients with respect to their features, and to every weight and bias."""
    from ggavatar.networks import mlp_kernel as kernels

    matrices = tuple(_flat(matrix) for matrix in (*ctx.saved_tensors, upstream.contiguous()))
    found = kernels.backward(matrices, ctx.layers)
    return found.rows, found.features, [torch.from_numpy(np.array(part)) for layer in found.layers for part in layer]


def _flat(tensor: Tensor) -> Any:
    return tensor.view(-1).numpy()
