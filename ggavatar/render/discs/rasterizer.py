"""Rasterizer of discs (PointAvatar): compiled kernels on a CPU, Triton kernels on CUDA, plain torch elsewhere."""

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
from ggavatar.jit import device_kernels
from ggavatar.jit.dispatch import compiled_for
from ggavatar.render.checks import camera_tensors, check_finite, check_shapes
from ggavatar.render.discs import reference
from ggavatar.render.discs.values import DiscRendering, Discs, project_discs, radius_in_pixels


def rasterizer(device: torch.device | str, backend: str = "auto") -> Rasterizer:
    """The rasterizer of discs for tensors on `device`.

    Args:
        device: Device of the points.
        backend: `reference` for plain torch; any other name chooses the fastest one for the tensors it is given.
    """
    if backend == "reference":
        return _reference
    return _on_device() if torch.device(device).type == "cuda" and not device_kernels.missing("cuda") else rasterize


def _on_device() -> Rasterizer:
    """A new rasterizer of Triton kernels, which learns as it renders; what is not float32 goes to the reference."""
    from ggavatar.render.discs.device_rasterizer import DeviceDiscs

    draw = DeviceDiscs()

    def rasterize_on_device(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> DiscRendering:
        discs = _discs(gaussians, camera, background)
        if len(discs.means) == 0 or not device_kernels.run_on(discs.means, discs.colors):
            return _reference(gaussians, camera, background)
        return draw(discs, camera, background)

    return rasterize_on_device


def rasterize(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> DiscRendering:
    """Render the ten nearest discs of every pixel, blended front to back.

    Args:
        gaussians: Discs with RGB colors.
        camera: Differentiable in `world_to_camera`.
        background: sRGB color, without gradient.

    Returns:
        The rendering; its depth has no gradient.

    Raises:
        InputError: `gaussians` are not discs with RGB colors, shapes do not match, or a tensor holds NaN or infinity.
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
    """The discs, after checking that they can be rendered and are finite."""
    discs = _discs(gaussians, camera, background)
    rendered = {"gaussians.means": discs.means, "gaussians.colors": discs.colors}
    check_finite(rendered | camera_tensors(camera, background))
    return discs


def _discs(gaussians: Gaussians, camera: Camera, background: Tensor) -> Discs:
    """The discs, after checking what can be checked without looking at their numbers."""
    if not isinstance(gaussians, Discs) or gaussians.colors.ndim != 2:
        raise InputError(
            f"expected discs with RGB colors, found {type(gaussians).__name__}; "
            "render Gaussians with the rasterizer of ggavatar.render.backends.pick"
        )
    check_shapes(gaussians, camera, background)
    return gaussians


class _Rasterize(torch.autograd.Function):
    """(projected centers, colors) → image, alpha, depth, shown."""

    @staticmethod
    def forward(ctx: Any, size: tuple[int, int, float], *inputs: Tensor) -> tuple[Tensor, ...]:
        stages = importlib.import_module("ggavatar.render.discs.stages")
        width, height, _ = size
        discs = stages.bin_discs(size, *inputs)
        drawing, shown = stages.draw(discs)
        image, transmittance = (torch.from_numpy(values) for values in (drawing.image, drawing.transmittance))
        depth, is_shown = torch.from_numpy(drawing.depth).view(height, width, 1), torch.from_numpy(shown)
        ctx.discs, ctx.drawing = discs, drawing
        ctx.mark_non_differentiable(depth, is_shown)
        ctx.set_materialize_grads(False)
        return image.view(height, width, 3), 1 - transmittance.view(height, width, 1), depth, is_shown

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_image: Tensor | None, to_alpha: Tensor | None, *_: Any) -> tuple[Tensor | None, ...]:
        stages = importlib.import_module("ggavatar.render.discs.stages")
        pixels = ctx.drawing.transmittance.size
        upstream = [
            np.zeros(pixels * channels, np.float32) if gradient is None else gradient.contiguous().view(-1).numpy()
            for gradient, channels in ((to_image, 3), (to_alpha, 1))
        ]
        to_colors, to_means2d = stages.differentiate(ctx.discs, ctx.drawing, *upstream)
        return None, None, None, None, torch.from_numpy(to_means2d), torch.from_numpy(to_colors)
