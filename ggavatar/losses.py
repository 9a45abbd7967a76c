"""The terms of the training objective as pure functions (GGAvatar Eq. 13–16); weights belong to the methods."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import huber_loss, l1_loss

from ggavatar.dssim import DssimTarget, dssim

__all__ = ["DssimTarget", "dssim", "huber", "l1", "position_regulariser", "scale_regulariser"]


def l1(image: Float[Tensor, "H W C"], target: Float[Tensor, "H W C"]) -> Float[Tensor, ""]:
    """Mean absolute difference over pixels and channels."""
    return l1_loss(image, target)


def huber(image: Float[Tensor, "H W C"], target: Float[Tensor, "H W C"], delta: float = 0.1) -> Float[Tensor, ""]:
    """Mean of d²/2 where |d| < `delta` and `delta`·(|d| − `delta`/2) elsewhere (FlashAvatar)."""
    return huber_loss(image, target, delta=delta)


def position_regulariser(
    local_means: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"], threshold: float = 1.0
) -> Float[Tensor, ""]:
    """Mean over visible Gaussians of max(‖μ0‖ − `threshold`, 0); 0 if none is visible.

    Args:
        local_means: Positions in units of the triangle's size.
        visible: Gaussians that touched the image.
        threshold: Distance from the triangle's centre that costs nothing, in units of its size.

    References:
        GGAvatar Eq. 14 read as in GaussianAvatars (docs/paper.md, A15, A16): on the norm, of local positions.
    """
    square = local_means.square().sum(-1)
    beyond = square > threshold**2
    length = square.where(beyond, square.new_tensor(1.0)).sqrt()
    return _mean_where((length - threshold) * beyond, visible)


def scale_regulariser(
    local_scales: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"], threshold: float = 0.6
) -> Float[Tensor, ""]:
    """Mean over visible Gaussians of ‖max(s0 − `threshold`, 0)‖; 0 if none is visible.

    Args:
        local_scales: Standard deviations (not their logarithms) in units of the triangle's size.
        visible: Gaussians that touched the image.
        threshold: Standard deviation that costs nothing, in units of the triangle's size.

    References:
        GGAvatar Eq. 15; on local scales (docs/paper.md, A16).
    """
    square = (local_scales - threshold).clamp_min(0).square().sum(-1)
    beyond = square > 0
    length = square.where(beyond, square.new_tensor(1.0)).sqrt()
    return _mean_where(length * beyond, visible)


def _mean_where(values: Tensor, visible: Tensor) -> Tensor:
    """Mean of `values` over the visible rows, 0 (still attached to the graph) if there is none."""
    return (values * visible).sum() / visible.sum().clamp_min(1)
