"""The rasterizer for training on a CPU: compiled kernels over 16-lane vectors behind one autograd function.

It computes what `ggavatar.render.reference` does, in float32. Results are bit-identical for any number of threads:
pieces of work have a fixed size, every sum has a fixed order, and nothing is added atomically.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.errors import InputError
from ggavatar.jit.padding import flat, padded
from ggavatar.render.checks import FIELDS, VIEW_NAMES, check_finite, check_shapes
from ggavatar.render.cpu.backward import Incoming
from ggavatar.render.cpu.forward import Canvas
from ggavatar.render.cpu.layout import Cloud
from ggavatar.render.cpu.stages import (
    ViewConstants,
    bin_and_color,
    cropped,
    differentiate_all,
    draw_all,
    project_all,
    view_array,
    whole_tiles,
)
from ggavatar.render.harmonics import used_degree


def rasterize(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
    """Render Gaussians on a constant background.

    Args:
        gaussians: On the CPU; other dtypes than float32 and non-contiguous tensors are converted.
        camera: Differentiable in `world_to_camera`, not in `intrinsics`.
        background: sRGB color, differentiable.

    Returns:
        The rendering in float32.

    Raises:
        InputError: Shapes do not match, a tensor holds NaN or infinity, or `intrinsics` requires a gradient.
    """
    check_shapes(gaussians, camera, background)
    if camera.intrinsics.requires_grad:
        raise InputError(
            "camera.intrinsics: the cpu rasterizer computes no gradient of intrinsics; detach them, or use the "
            "reference rasterizer"
        )
    colors = gaussians.colors
    degree = used_degree(colors.shape[1], gaussians.sh_degree) if colors.ndim == 3 else -1
    means2d = padded(gaussians.means.shape[0], 2).requires_grad_(torch.is_grad_enabled())
    constants = ViewConstants(camera.intrinsics.detach().double().numpy(), camera.width, camera.height, degree)
    inputs = [_contiguous_float32(getattr(gaussians, name)) for name in FIELDS]
    pose, background = _contiguous_float32(camera.world_to_camera), _contiguous_float32(background)
    image, alpha, depth, radii = _Rasterize.apply(constants, means2d, pose, background, *inputs)
    return Rendering(image, alpha, depth, means2d, radii)


def _contiguous_float32(tensor: Tensor) -> Tensor:
    return tensor.to(torch.float32).contiguous()


def _cloud(inputs: tuple[Tensor, ...], degree: int) -> Cloud:
    """The input tensors as flat arrays."""
    means, quats, scales, opacities, colors = (flat(tensor) for tensor in inputs)
    coefficients = inputs[4].shape[1] if inputs[4].ndim == 3 else 0
    return Cloud(means, quats, scales, opacities, colors, opacities.size, coefficients, degree)


class _Rasterize(torch.autograd.Function):
    """(means2d, pose, background, Gaussians) → image, alpha, depth, radii; also writes `means2d`."""

    @staticmethod
    def forward(
        ctx: Any, constants: ViewConstants, means2d: Tensor, pose: Tensor, background: Tensor, *inputs: Tensor
    ) -> tuple[Tensor, ...]:
        """Project, sort into tiles and blend; an input that is not finite is looked for only where a result is not."""
        view, cloud = view_array(constants, pose, background), _cloud(inputs, constants.degree)
        radii = padded(len(means2d))
        if not np.isfinite(view).all():
            named = zip(VIEW_NAMES, (torch.from_numpy(constants.intrinsics), pose, background), strict=True)
            check_finite(dict(named))
        footprints = project_all(cloud, view, means2d, radii)
        bins = bin_and_color(cloud, view, footprints)
        if not np.isfinite(footprints.faults).all():
            check_finite({f"gaussians.{name}": tensor for name, tensor in zip(FIELDS, inputs, strict=True)})
        tensors, hits, ends = draw_all(bins, footprints.records, view)
        image, transmittance, depth, alpha = tensors
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(radii)
        ctx.save_for_backward(pose, *inputs, image, transmittance, depth)
        ctx.constants, ctx.view, ctx.footprints = constants, view, footprints
        ctx.bins, ctx.hits_ends = bins, (hits, ends)
        return cropped(image, constants), cropped(alpha, constants), cropped(depth, constants), radii

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *incoming: Tensor | None) -> tuple[Tensor | None, ...]:
        """Gradients of projected centers, camera pose, background and Gaussians, given those of the outputs."""
        pose, *inputs, image, transmittance, depth = ctx.saved_tensors
        upstream = [
            whole_tiles(gradient, like) for gradient, like in zip(incoming, (image, transmittance, depth), strict=False)
        ]
        # The backward pass reads transmittance and not alpha, whose place it takes here.
        canvas = Canvas(flat(image), flat(transmittance), flat(depth), flat(transmittance), *ctx.hits_ends)
        work = ctx.footprints, ctx.bins, canvas, Incoming(*(flat(tensor) for tensor in upstream))
        gradients, sums = differentiate_all(_cloud(tuple(inputs), ctx.constants.degree), ctx.view, *work)
        means, quats, scales, opacities, colors, means2d = gradients
        colors = colors.view_as(inputs[4])
        background = _background_gradient(upstream[0], transmittance) if ctx.needs_input_grad[3] else None
        return None, means2d, _pose_gradient(pose, sums), background, means, quats, scales, opacities, colors


def _pose_gradient(pose: Tensor, sums: np.ndarray) -> Tensor:
    """Gradient of `world_to_camera`, given sums for its rotation, its translation and the camera center −Rᵀ t."""
    transform, center = pose.double().numpy(), sums[12:]
    gradient = np.zeros((4, 4))
    gradient[:3, :3] = sums[:9].reshape(3, 3) - np.outer(transform[:3, 3], center)
    gradient[:3, 3] = sums[9:12] - transform[:3, :3] @ center
    return torch.from_numpy(gradient.astype(np.float32))


def _background_gradient(image: Tensor, transmittance: Tensor) -> Tensor:
    """Sum over the pixels of gradient times transmittance, in one thread and therefore always in the same order."""
    incoming, remaining = image.numpy().reshape(-1, 3), transmittance.numpy().reshape(-1)
    total = np.einsum("pc,p->c", incoming.astype(np.float64), remaining.astype(np.float64))
    return torch.from_numpy(total.astype(np.float32))
