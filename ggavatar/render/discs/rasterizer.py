"""Rasterizer of discs (PointAvatar): compiled kernels on a CPU, plain torch elsewhere."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from ggavatar.core import Camera, Gaussians, Rasterizer
from ggavatar.errors import InputError
from ggavatar.jit.dispatch import compiled_for
from ggavatar.render.checks import camera_tensors, check_finite, check_shapes
from ggavatar.render.discs import reference
from ggavatar.render.discs.values import DiscRendering, Discs, project_discs, radius_in_pixels


def rasterizer(device: torch.device | str, backend: str = "auto") -> Rasterizer:
    """The renderer of discs for tensors on `device`.

    Args:
        device: Where the points live.
        backend: `reference` for plain torch; every other name takes what is fastest on the device.
    """
    return _reference if backend == "reference" else rasterize


def rasterize(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> DiscRendering:
    """Draw the ten nearest discs of every pixel, front to back.

    Args:
        gaussians: Discs with RGB colors.
        camera: Differentiable in `world_to_camera`.
        background: sRGB, without gradient.

    Returns:
        The rendering, its depth without gradient.

    Raises:
        InputError: These are no discs, shapes do not fit, or a tensor holds NaN or infinity.
    """
    discs = _checked(gaussians, camera, background)
    if not compiled_for(discs.means, discs.colors):
        return reference.rasterize(discs, camera, background)
    means2d, depths, radii = project_discs(discs.means, discs.radius, camera)
    if means2d.requires_grad:
        means2d.retain_grad()
    size = camera.width, camera.height, radius_in_pixels(discs.radius, camera)
    inputs = depths.detach(), radii.detach(), background.detach().float()
    image, alpha, depth, shown = _Rasterize.apply(size, *inputs, means2d.contiguous(), discs.colors.contiguous())
    return DiscRendering(image, alpha, depth, means2d, radii, shown)


def _reference(gaussians: Gaussians, camera: Camera, background: Tensor) -> DiscRendering:
    return reference.rasterize(_checked(gaussians, camera, background), camera, background)


def _checked(gaussians: Gaussians, camera: Camera, background: Tensor) -> Discs:
    """The discs, if they can be drawn."""
    if not isinstance(gaussians, Discs) or gaussians.colors.ndim != 2:
        raise InputError(f"expected discs with RGB colors, found {type(gaussians).__name__}; draw those with pick()")
    check_shapes(gaussians, camera, background)
    drawn = {"gaussians.means": gaussians.means, "gaussians.colors": gaussians.colors}
    check_finite(drawn | camera_tensors(camera, background))
    return gaussians


class _Rasterize(torch.autograd.Function):
    """(image positions, colors) → image, alpha, depth, shown."""

    @staticmethod
    def forward(ctx: Any, size: tuple[int, int, float], *inputs: Tensor) -> tuple[Tensor, ...]:
        stages = importlib.import_module("ggavatar.render.discs.stages")
        width, height, _ = size
        placed = stages.place(size, *inputs)
        drawing, shown = stages.draw(placed)
        image, light = (torch.from_numpy(values) for values in (drawing.image, drawing.light))
        depth = torch.from_numpy(drawing.depth).view(height, width, 1)
        marks = torch.from_numpy(shown)
        ctx.placed, ctx.drawing = placed, drawing
        ctx.mark_non_differentiable(depth, marks)
        ctx.set_materialize_grads(False)
        return image.view(height, width, 3), 1 - light.view(height, width, 1), depth, marks

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_image: Tensor | None, to_alpha: Tensor | None, *_: Any) -> tuple[Tensor | None, ...]:
        stages = importlib.import_module("ggavatar.render.discs.stages")
        pixels = ctx.drawing.light.size
        arriving = [
            np.zeros(pixels * channels, np.float32) if gradient is None else gradient.contiguous().view(-1).numpy()
            for gradient, channels in ((to_image, 3), (to_alpha, 1))
        ]
        to_colors, to_means2d = stages.differentiate(ctx.placed, ctx.drawing, *arriving)
        return None, None, None, None, torch.from_numpy(to_means2d), torch.from_numpy(to_colors)
