"""Reference rasterizer of discs in plain torch: any dtype, any device, differentiable in everything but the order."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera
from ggavatar.render.discs.values import NEAREST, SHOWN_WEIGHT, DiscRendering, Discs, project_discs, radius_in_pixels

ROWS = 8
"""Image rows that are rendered together; memory grows with their pixels times the discs that touch them."""


def rasterize(discs: Discs, camera: Camera, background: Float[Tensor, " 3"]) -> DiscRendering:
    """Render the ten nearest discs of every pixel, blended front to back.

    Args:
        discs: In world space; their dtype and device are those of the result.
        camera: Pinhole camera, differentiable.
        background: sRGB color.

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
        shown[near[_shown(pixels, means2d.detach()[near] / reach, reach)]] = True
    features = torch.cat(strips).reshape(camera.height, camera.width, 5)
    transmittance = features[..., 4:]
    image = features[..., :3] + transmittance * background.to(transmittance)
    return DiscRendering(image, 1 - transmittance, features[..., 3:4], means2d, radii, shown)


def _pixels(top: int, camera: Camera, like: Tensor) -> Float[Tensor, "P 2"]:
    """Pixel centers of a strip of rows, row by row."""
    x = torch.arange(camera.width).to(like) + 0.5
    y = torch.arange(top, min(top + ROWS, camera.height)).to(like) + 0.5
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)


def _weights(
    pixels: Float[Tensor, "P 2"], centers: Float[Tensor, "N 2"], reach: float
) -> tuple[Float[Tensor, "P N"], Float[Tensor, "P 1"]]:
    """Blending weight of every disc (centers in radii, front to back) in every pixel, and the final transmittance."""
    square = (pixels[:, None] / reach - centers).square().sum(-1)
    touching = square.detach() < 1
    nearest = touching & (touching.cumsum(1) <= NEAREST)
    alphas = torch.where(nearest, 1 - square, 0)
    before = torch.cat((alphas.new_ones(len(alphas), 1), 1 - alphas), dim=1).cumprod(1)
    return alphas * before[:, :-1], before[:, -1:]


def _draw(pixels: Tensor, centers: Tensor, features: Tensor, reach: float) -> Float[Tensor, "P 5"]:
    """Composited features and the final transmittance."""
    weights, transmittance = _weights(pixels, centers, reach)
    return torch.cat((weights @ features, transmittance), dim=1)


def _shown(pixels: Tensor, centers: Tensor, reach: float) -> Tensor:
    """Which discs are the first one in some pixel, or have a weight above one half in one."""
    weights, _ = _weights(pixels, centers, reach)
    touching = (pixels[:, None] / reach - centers).square().sum(-1) < 1
    first = touching & (touching.cumsum(1) == 1)
    return (first | (weights > SHOWN_WEIGHT)).any(0)
