"""The yardstick for discs: plain torch, any dtype, any device, differentiable in everything but the order of depths."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera
from ggavatar.render.discs.values import NEAREST, SHOWN_WEIGHT, DiscRendering, Discs, project_discs, radius_in_pixels

ROWS = 8
"""Rows of the image looked at together; memory grows with their pixels times the discs that touch them."""


def rasterize(discs: Discs, camera: Camera, background: Float[Tensor, " 3"]) -> DiscRendering:
    """Draw the ten nearest discs of every pixel, front to back.

    Args:
        discs: In world space; their dtype and device are those of the result.
        camera: Pinhole; differentiable.
        background: sRGB.

    References:
        PointAvatar (Zheng et al. 2023), Sec. 3.3; alpha = 1 − d²/r².
    """
    means2d, depths, radii = project_discs(discs.means, discs.radius, camera)
    if means2d.requires_grad:
        means2d.retain_grad()
    shown = torch.zeros_like(radii, dtype=torch.bool)
    order = torch.argsort(depths.detach(), stable=True)
    order = order[radii[order] > 0]
    features = torch.cat((discs.colors, depths[:, None]), dim=1)
    reach = radius_in_pixels(discs.radius, camera)
    strips = []
    for top in range(0, camera.height, ROWS):
        pixels = _pixels(top, camera, means2d)
        y = means2d.detach()[order, 1]
        near = order[(y + reach > top) & (y - reach < top + ROWS)]
        strips.append(_draw(pixels, means2d[near] / reach, features[near], reach))
        shown[near[_showing(pixels, means2d.detach()[near] / reach, reach)]] = True
    drawn = torch.cat(strips).reshape(camera.height, camera.width, 5)
    light = drawn[..., 4:]
    image = drawn[..., :3] + light * background.to(light)
    return DiscRendering(image, 1 - light, drawn[..., 3:4], means2d, radii, shown)


def _pixels(top: int, camera: Camera, like: Tensor) -> Float[Tensor, "P 2"]:
    """Centers of the pixels of a strip, row by row."""
    x = torch.arange(camera.width).to(like) + 0.5
    y = torch.arange(top, min(top + ROWS, camera.height)).to(like) + 0.5
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)


def _weights(
    pixels: Float[Tensor, "P 2"], centers: Float[Tensor, "N 2"], reach: float
) -> tuple[Float[Tensor, "P N"], Float[Tensor, "P 1"]]:
    """Share of every disc (centers in radii, front to back) in every pixel, and the light that is left."""
    square = (pixels[:, None] / reach - centers).square().sum(-1)
    touching = square.detach() < 1
    nearest = touching & (touching.cumsum(1) <= NEAREST)
    alphas = torch.where(nearest, 1 - square, 0)
    before = torch.cat((alphas.new_ones(len(alphas), 1), 1 - alphas), dim=1).cumprod(1)
    return alphas * before[:, :-1], before[:, -1:]


def _draw(pixels: Tensor, centers: Tensor, features: Tensor, reach: float) -> Float[Tensor, "P 5"]:
    """Composited features and the light that is left."""
    weights, light = _weights(pixels, centers, reach)
    return torch.cat((weights @ features, light), dim=1)


def _showing(pixels: Tensor, centers: Tensor, reach: float) -> Tensor:
    """Which discs are the first one in a pixel or weigh more than a half in one."""
    weights, _ = _weights(pixels, centers, reach)
    touching = (pixels[:, None] / reach - centers).square().sum(-1) < 1
    first = touching & (touching.cumsum(1) == 1)
    return (first | (weights > SHOWN_WEIGHT)).any(0)
