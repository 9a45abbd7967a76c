"""The reference rasterizer in plain torch: any dtype, any device, differentiable in everything.

It blends all Gaussians of an image tile at once. Its memory grows with pixels × Gaussians per tile, so it suits small
images; `ggavatar.render.cpu.rasterizer` and `ggavatar.render.triton.rasterizer` are the fast ones.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.render.checks import camera_tensors, check_finite, check_shapes, gaussian_tensors
from ggavatar.render.constants import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE
from ggavatar.render.harmonics import sh_to_rgb, used_degree
from ggavatar.render.projection import Projected, camera_center, project, visible

TILE = 32
"""Pixels along a side of a tile."""


def rasterize(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
    """Render Gaussians on a constant background.

    Args:
        gaussians: In world space; their dtype and device are those of the result.
        camera: Pinhole camera, differentiable in `world_to_camera` and `intrinsics`.
        background: sRGB color, differentiable.

    Returns:
        The rendering.

    Raises:
        InputError: Shapes do not match, or a tensor holds NaN or infinity.

    References:
        Kerbl et al. 2023, Eq. 1–5.
    """
    check_shapes(gaussians, camera, background)
    check_finite(gaussian_tensors(gaussians) | camera_tensors(camera, background))
    camera, background = _camera_like(camera, gaussians.means), background.to(gaussians.means)
    rows, radii = _visible_rows(gaussians, camera)
    visible_gaussians = select_rows(gaussians, rows)
    projected = project(visible_gaussians, camera)
    means2d = torch.zeros_like(gaussians.means[:, :2]).index_copy(0, rows, projected.means2d)
    if means2d.requires_grad:
        means2d.retain_grad()
    projected = dataclasses.replace(projected, means2d=means2d[rows])
    features = torch.cat((colors_of(visible_gaussians, camera), projected.depths[:, None]), dim=1)
    sums, transmittance = _draw_tiles(Splats(projected, visible_gaussians.opacities, features), camera)
    image = sums[..., :3] + transmittance * background
    return Rendering(image, 1 - transmittance, sums[..., 3:], means2d, radii)


class Splats(NamedTuple):
    """Projected Gaussians, front to back, with the features that are blended: color and depth."""

    projected: Projected
    opacities: Float[Tensor, " N"]
    features: Float[Tensor, "N 4"]


def _camera_like(camera: Camera, tensor: Tensor) -> Camera:
    """The camera in the dtype and on the device of `tensor`."""
    return Camera(camera.intrinsics.to(tensor), camera.world_to_camera.to(tensor), camera.width, camera.height)


@torch.no_grad()
def _visible_rows(gaussians: Gaussians, camera: Camera) -> tuple[Tensor, Tensor]:
    """Indices of the visible Gaussians, front to back, and the radii of all."""
    projected = project(gaussians, camera)
    is_visible = visible(projected, gaussians.opacities, camera)
    radii = torch.where(is_visible, projected.extents.amax(-1), 0)
    order = torch.argsort(projected.depths, stable=True)
    return order[is_visible[order]], radii


def select_rows(gaussians: Gaussians, rows: Tensor) -> Gaussians:
    """The Gaussians at `rows`, in that order."""
    fields = {name: getattr(gaussians, name)[rows] for name in ("means", "quats", "scales", "opacities", "colors")}
    return dataclasses.replace(gaussians, **fields)


def colors_of(gaussians: Gaussians, camera: Camera) -> Float[Tensor, "N 3"]:
    """RGB as seen from the camera."""
    if gaussians.colors.ndim == 2:
        return gaussians.colors
    degree = used_degree(gaussians.colors.shape[1], gaussians.sh_degree)
    return sh_to_rgb(gaussians.colors, gaussians.means, camera_center(camera.world_to_camera), degree)


def _draw_tiles(splats: Splats, camera: Camera) -> tuple[Tensor, Tensor]:
    """Blended features [H, W, 4] and final transmittance [H, W, 1], tile by tile."""
    rows = []
    for top in range(0, camera.height, TILE):
        bottom = min(top + TILE, camera.height)
        tiles = [
            _draw_tile(splats, (left, top, min(left + TILE, camera.width), bottom))
            for left in range(0, camera.width, TILE)
        ]
        rows.append(torch.cat(tiles, dim=1))
    image = torch.cat(rows, dim=0)
    return image[..., :4], image[..., 4:]


def _draw_tile(splats: Splats, box: tuple[int, int, int, int]) -> Tensor:
    """Blended features and transmittance [h, w, 5] of the pixels left ≤ x < right, top ≤ y < bottom."""
    left, top, right, bottom = box
    means2d, extents = splats.projected.means2d.detach(), splats.projected.extents
    low, high = means2d - extents, means2d + extents
    inside = (high[:, 0] > left) & (low[:, 0] < right) & (high[:, 1] > top) & (low[:, 1] < bottom)
    touching = torch.nonzero(inside)[:, 0]
    like = splats.features
    x = torch.arange(left, right, dtype=like.dtype, device=like.device) + 0.5
    y = torch.arange(top, bottom, dtype=like.dtype, device=like.device) + 0.5
    pixels = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)
    means2d, conics = splats.projected.means2d[touching], splats.projected.conics[touching]
    weights, transmittance = blend_weights(alphas_at(pixels, means2d, conics, splats.opacities[touching]))
    blended = torch.cat((weights @ splats.features[touching], transmittance[:, None]), dim=1)
    return blended.reshape(bottom - top, right - left, 5)


def alphas_at(
    pixels: Float[Tensor, "P 2"],
    means2d: Float[Tensor, "N 2"],
    conics: Float[Tensor, "N 3"],
    opacities: Float[Tensor, " N"],
) -> Float[Tensor, "P N"]:
    """Alpha of every Gaussian in every pixel: opacity · exp(−½ dᵀ conic d), at most 0.99, and 0 below 1/255."""
    dx, dy = (pixels[:, None, :] - means2d).unbind(-1)
    half = 0.5 * (conics[:, 0] * dx * dx + conics[:, 2] * dy * dy) + conics[:, 1] * dx * dy
    alphas = opacities * torch.exp(-half)
    return torch.where(alphas >= MIN_ALPHA, alphas.clamp_max(MAX_ALPHA), 0)


def blend_weights(alphas: Float[Tensor, "P N"]) -> tuple[Float[Tensor, "P N"], Float[Tensor, " P"]]:
    """Front-to-back weights alpha · T and the final transmittance T.

    A pixel is finished before the Gaussian that would reduce T below 1e-4.
    """
    blended = torch.cumprod(1 - alphas.detach(), dim=1) >= MIN_TRANSMITTANCE
    alphas = torch.where(blended, alphas, 0)
    after = torch.cumprod(1 - alphas, dim=1)
    before = torch.cat((alphas.new_ones(len(alphas), 1), after), dim=1)
    return alphas * before[:, :-1], before[:, -1]
