"""Gaussians that no training picture shows: their summed weight in the pictures, and which can go."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ggavatar.core import Avatar, Camera, Drive, Rasterizer
from ggavatar.render.constants import MIN_ALPHA

VIEWS = 48
"""Training pictures in which the weights are summed."""


def visible_weights(
    avatar: Avatar, rasterize: Rasterizer, views: Sequence[tuple[Drive, Camera]]
) -> Float[Tensor, " N"]:
    """The weight of every Gaussian, summed over the pixels of the picture that shows it best, px.

    It is the rasterizer's own derivative of the picture by the Gaussian's color.
    """
    best: Tensor | None = None
    for drive, camera in views:
        with torch.no_grad():
            gaussians = avatar.gaussians(drive)
        black = torch.zeros_like(gaussians.means).requires_grad_()
        drawn = rasterize(dataclasses.replace(gaussians, colors=black, sh_degree=None), camera, black.new_zeros(3))
        weights = torch.autograd.grad(drawn.image.sum(), black)[0][:, 0]
        best = weights if best is None else torch.maximum(best, weights)
    if best is None:
        raise ValueError("expected at least one view, got none")
    return best


def kept_rows(weights: Float[Tensor, " N"], opacities: Float[Tensor, " N"], share: float) -> Bool[Tensor, " N"]:
    """All but Gaussians that no rasterizer blends, and the least visible, which hold `share` of the summed weight."""
    ascending, order = weights.double().sort()
    dropped = ascending.cumsum(0) <= share * ascending.sum()
    keep = opacities >= MIN_ALPHA
    keep[order[dropped]] = False
    return keep
