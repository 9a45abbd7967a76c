"""Terms of the training objective as pure functions: L1, Huber and the regularizers (GGAvatar Eq. 14–15)."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import huber_loss, l1_loss

from ggavatar.jit import device_kernels
from ggavatar.jit.dispatch import compiled_for
from ggavatar.jit.padding import memory_of, padded


def l1(image: Float[Tensor, "H W C"], target: Float[Tensor, "H W C"]) -> Float[Tensor, ""]:
    """Mean absolute difference over pixels and channels; the gradient flows into `image` only."""
    if compiled_for(image, target):
        return cast(Tensor, _CompiledL1.apply(image, target))
    return l1_loss(image, target.detach())


def huber(image: Float[Tensor, "H W C"], target: Float[Tensor, "H W C"], delta: float = 0.1) -> Float[Tensor, ""]:
    """Mean of d²/2 where |d| < `delta` and `delta`·(|d| − `delta`/2) elsewhere (FlashAvatar)."""
    return huber_loss(image, target, delta=delta)


def position_regularizer(
    local_means: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"], threshold: float = 1.0, weight: float = 1.0
) -> Float[Tensor, ""]:
    """`weight` times the mean over visible Gaussians of max(‖μ0‖ − `threshold`, 0); 0 if none is visible.

    Args:
        local_means: Positions in units of the triangle's size.
        visible: Gaussians that touch the image.
        threshold: Distance from the triangle's center up to which the cost is 0, in units of its size.
        weight: Factor of the term in the objective.

    References:
        GGAvatar Eq. 14, read as in GaussianAvatars (docs/paper.md, A15, A16): the norm of local positions.
    """
    if compiled_for(local_means):
        return weight * cast(Tensor, _CompiledRegularizer.apply(local_means, visible, threshold, "POSITION"))
    if device_kernels.run_on(local_means, visible):
        from ggavatar.losses import regularizers_triton

        return regularizers_triton.regularizer(local_means, visible, threshold, weight, regularizers_triton.POSITION)
    return weight * position_regularizer_in_torch(local_means, visible, threshold)


def position_regularizer_in_torch(
    local_means: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"], threshold: float = 1.0
) -> Float[Tensor, ""]:
    """`position_regularizer` in plain torch: any dtype and device."""
    square = local_means.square().sum(-1)
    exceeds = square > threshold**2
    length = square.where(exceeds, 1.0).sqrt()
    return _mean_where((length - threshold) * exceeds, visible)


def log_scale_regularizer(
    local_log_scales: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"], threshold: float = 0.6, weight: float = 1.0
) -> Float[Tensor, ""]:
    """`weight` times the mean over visible Gaussians of ‖max(s0 − `threshold`, 0)‖; 0 if none is visible.

    s0 are the exponentials of the logarithms.

    Args:
        local_log_scales: Logarithms of standard deviations in units of the triangle's size.
        visible: Gaussians that touch the image.
        threshold: Standard deviation up to which the cost is 0, in units of the triangle's size.
        weight: Factor of the term in the objective.

    References:
        GGAvatar Eq. 15; on local scales (docs/paper.md, A16).
    """
    if compiled_for(local_log_scales):
        return weight * cast(Tensor, _CompiledRegularizer.apply(local_log_scales, visible, threshold, "LOG_SCALE"))
    if device_kernels.run_on(local_log_scales, visible):
        from ggavatar.losses import regularizers_triton

        return regularizers_triton.regularizer(
            local_log_scales, visible, threshold, weight, regularizers_triton.LOG_SCALE
        )
    return weight * log_scale_regularizer_in_torch(local_log_scales, visible, threshold)


def log_scale_regularizer_in_torch(
    local_log_scales: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"], threshold: float = 0.6
) -> Float[Tensor, ""]:
    """`log_scale_regularizer` in plain torch: any dtype and device."""
    square = (local_log_scales.exp() - threshold).clamp_min(0).square().sum(-1)
    exceeds = square > 0
    length = square.where(exceeds, 1.0).sqrt()
    return _mean_where(length * exceeds, visible)


def _mean_where(values: Tensor, visible: Tensor) -> Tensor:
    """Mean of `values` over the visible rows; 0, attached to the graph, if there is none."""
    return (values * visible).sum() / visible.sum().clamp_min(1)


class _CompiledL1(torch.autograd.Function):
    """The compiled L1; forward computes the signs, and backward scales them."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor) -> Tensor:
        from ggavatar.losses import terms_kernel as kernels

        signs = torch.empty(image.numel() if ctx.needs_input_grad[0] else 0)
        total = kernels.l1_sum(_flat(image), _flat(target), signs.numpy())
        ctx.save_for_backward(signs)
        ctx.shape = image.shape
        return image.new_tensor(total / max(image.numel(), 1))

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        (signs,) = ctx.saved_tensors
        return (signs * (upstream / max(signs.numel(), 1))).view(ctx.shape), None


class _CompiledRegularizer(torch.autograd.Function):
    """The compiled regularizers; `kind` is the name of a constant in `ggavatar.losses.terms_kernel`."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, visible: Tensor, threshold: float, kind: str) -> Tensor:
        from ggavatar.losses import terms_kernel as kernels

        ctx.inputs = getattr(kernels, kind), _flat(rows), _flat(visible), np.float32(threshold)
        total, seen = kernels.regularizer_sum(*ctx.inputs)
        ctx.count = max(seen, 1)
        return rows.new_tensor(total / ctx.count)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None]:
        from ggavatar.losses import terms_kernel as kernels

        gradient = padded(ctx.inputs[2].size, 3)
        kernels.regularizer_gradient(*ctx.inputs, np.float32(upstream.item() / ctx.count), memory_of(gradient))
        return gradient, None, None, None


def _flat(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().view(-1).numpy()
