"""The rasterizer for CUDA: Triton kernels behind one autograd function.

It computes what `ggavatar.render.reference` does, in float32, and never waits for the device. What is wrong with the
inputs is noticed when the device has told, at a later call. Results repeat bit for bit, unless there were more pairs of
Gaussian and tile than memory for them: such a rendering is right too, but slow, and its gradients are added atomically;
the next ones get more memory.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.errors import InputError
from ggavatar.render import reference
from ggavatar.render.checks import FIELDS, check_shapes
from ggavatar.render.harmonics import used_degree
from ggavatar.render.triton import stages
from ggavatar.render.triton.capacity import Memory


class TileRasterizer:
    """A rasterizer that remembers how many pairs of Gaussian and tile its renderings had."""

    def __init__(self) -> None:
        self._memory = Memory()

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        """Render Gaussians on a constant background.

        Args:
            gaussians: On a CUDA device; other dtypes than float32 and non-contiguous tensors are converted.
            camera: Differentiable in `world_to_camera`, not in `intrinsics`; moved to the device of the Gaussians.
            background: sRGB color, differentiable.

        Returns:
            The rendering in float32.

        Raises:
            InputError: Shapes do not match, `intrinsics` requires a gradient, or a tensor of an earlier rendering held
                NaN or infinity.
        """
        check_shapes(gaussians, camera, background)
        if camera.intrinsics.requires_grad:
            raise InputError(
                "camera.intrinsics: the triton rasterizer computes no gradient of intrinsics; detach them, or use the "
                "reference rasterizer"
            )
        self._memory.settle()
        rows = gaussians.means.shape[0]
        if rows == 0:
            return reference.rasterize(gaussians, camera, background)
        size = camera.width, camera.height
        capacity = self._memory.capacity(size, rows)
        rendering, status = _rasterize(gaussians, camera, background, capacity)
        self._memory.send(size, rows, capacity, status)
        return rendering


def _rasterize(gaussians: Gaussians, camera: Camera, background: Tensor, capacity: int) -> tuple[Rendering, Tensor]:
    """The rendering, and its status on the device."""
    colors, device = gaussians.colors, gaussians.means.device
    held = colors.shape[1] if colors.ndim == 3 else 0
    degree = used_degree(held, gaussians.sh_degree) if held else 0
    means2d = torch.empty(len(gaussians.means), 2, device=device, requires_grad=torch.is_grad_enabled())
    inputs = [_contiguous_float32(getattr(gaussians, name), device) for name in FIELDS]
    pose, intrinsics = (_contiguous_float32(k, device) for k in (camera.world_to_camera, camera.intrinsics))
    sizes = camera.width, camera.height, held, degree, capacity
    image, alpha, depth, radii, status = _Rasterize.apply(
        sizes, means2d, pose, _contiguous_float32(background, device), intrinsics, *inputs
    )
    return Rendering(image, alpha, depth, means2d, radii), status


def _contiguous_float32(tensor: Tensor, device: torch.device) -> Tensor:
    return tensor.to(device, torch.float32).contiguous()


class _Rasterize(torch.autograd.Function):
    """(means2d, pose, background, intrinsics, Gaussians) → image, alpha, depth, radii, status; writes `means2d`."""

    @staticmethod
    def forward(
        ctx: Any, sizes: tuple[int, ...], means2d: Tensor, pose: Tensor, background: Tensor, *inputs: Tensor
    ) -> tuple[Tensor, ...]:
        """Project, sort into tiles and draw."""
        *shape, capacity = sizes
        intrinsics, *cloud = inputs
        view = stages.View(pose, intrinsics, background, *shape)
        footprints, status = stages.project(view, tuple(cloud), means2d.detach())
        lists = stages.list_pairs(stages.tiles_of(view.width, view.height), footprints.placed, capacity, status)
        canvas = stages.draw(view, footprints.records, lists)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(footprints.radii, status)
        ctx.save_for_backward(
            pose, intrinsics, background, *cloud, *footprints[:2], *footprints.placed, *lists, *canvas
        )
        ctx.shape = shape
        return canvas.image, canvas.alpha, canvas.depth, footprints.radii, status

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *incoming: Tensor | None) -> tuple[Tensor | None, ...]:
        """Gradients of projected centers, camera pose, background and Gaussians, given those of the outputs."""
        pose, intrinsics, background, *saved = ctx.saved_tensors
        cloud, rest = tuple(saved[:5]), saved[5:]
        view = stages.View(pose, intrinsics, background, *ctx.shape)
        footprints = stages.Footprints(rest[0], rest[1], stages.Placed(*rest[2:5]))
        lists, canvas = stages.Lists(*rest[5:10]), stages.Canvas(*rest[10:])
        to_image, to_alpha, to_depth, *_ = (None if k is None else k.float().contiguous() for k in incoming)
        sums = stages.differentiate_tiles(view, footprints.records, lists, canvas, (to_image, to_alpha, to_depth))
        gradients, to_means2d, to_pose = stages.differentiate_gaussians(view, cloud, footprints, lists, sums)
        to_background = None
        if ctx.needs_input_grad[3] and to_image is not None:
            to_background = (to_image * canvas.light).sum((0, 1))
        return None, to_means2d, to_pose, to_background, None, *gradients
