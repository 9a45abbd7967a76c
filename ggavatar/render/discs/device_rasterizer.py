"""The rasterizer of discs for CUDA: Triton kernels behind one autograd function; it never waits for the device."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ggavatar.core import Camera
from ggavatar.jit import device_kernels
from ggavatar.render.discs import discs_triton as kernels
from ggavatar.render.discs.values import DiscRendering, Discs, project_discs, radius_in_pixels
from ggavatar.render.triton.capacity import Memory
from ggavatar.render.triton.layout import STATUS
from ggavatar.render.triton.stages import BLOCK, Lists, Placed, list_pairs, new_canvas, tiles_of


class Size(NamedTuple):
    """Width and height of the image and radius of the discs, px, and how many pairs of disc and tile have memory."""

    width: int
    height: int
    radius: float
    capacity: int


class DeviceDiscs:
    """A rasterizer that remembers how many pairs of disc and tile its renderings had."""

    def __init__(self) -> None:
        self._memory = Memory()

    def __call__(self, discs: Discs, camera: Camera, background: Tensor) -> DiscRendering:
        """Render discs, float32 on a CUDA device, whose shapes were checked.

        Raises:
            InputError: A tensor of an earlier rendering held NaN or infinity.
        """
        self._memory.settle()
        shape, rows = (camera.width, camera.height), len(discs.means)
        means2d, depths, radii = project_discs(discs.means, discs.radius, camera)
        if means2d.requires_grad:
            means2d.retain_grad()
        size = Size(*shape, radius_in_pixels(discs.radius, camera), self._memory.capacity(shape, rows))
        view = (camera.world_to_camera, camera.intrinsics, background)
        pose, intrinsics, background = (part.detach().to(means2d).contiguous() for part in view)
        fixed = discs.means.detach().contiguous(), depths.detach(), radii, pose, intrinsics, background
        image, alpha, depth, shown, status = _Rasterize.apply(
            size, fixed, means2d.contiguous(), discs.colors.contiguous()
        )
        self._memory.send(shape, rows, size.capacity, status)
        return DiscRendering(image, alpha, depth, means2d, radii, shown)


class _Rasterize(torch.autograd.Function):
    """(projected centers, colors) → image, alpha, depth, shown, status."""

    @staticmethod
    def forward(ctx: Any, size: Size, fixed: tuple[Tensor, ...], means2d: Tensor, colors: Tensor) -> tuple[Tensor, ...]:
        """Sort into tiles and draw."""
        means, depths, radii, pose, intrinsics, background = fixed
        rows, (across, down) = len(means2d), tiles_of(size.width, size.height)
        boxes, counts = colors.new_empty(rows, 4, dtype=torch.int32), colors.new_empty(rows, dtype=torch.int32)
        placed, status = Placed(torch.empty_like(depths), boxes, counts), counts.new_zeros(STATUS.value)
        device_kernels.launch(
            kernels.place_discs, -(-rows // BLOCK), means, means2d, depths, radii, colors, pose, intrinsics, background,
            *placed, status, rows, size.width, size.height, BLOCK=BLOCK,
        )  # fmt: skip
        lists = list_pairs((across, down), placed, size.capacity, status)
        canvas, shown = new_canvas(size.width, size.height, colors.device), counts.new_zeros(rows, dtype=torch.uint8)
        device_kernels.launch(
            kernels.draw_discs, across * down, means2d, depths, colors, counts, lists.entries, lists.order,
            lists.starts, lists.ends, background, *canvas, shown,
            rows, size.capacity, size.width, size.height, across, size.radius, warps=8,
        )  # fmt: skip
        ctx.size = size
        ctx.save_for_backward(means2d, colors, counts, *lists, canvas.image, canvas.light)
        is_shown = shown.view(torch.bool)
        ctx.mark_non_differentiable(canvas.depth, is_shown, status)
        ctx.set_materialize_grads(False)
        return canvas.image, canvas.alpha, canvas.depth, is_shown, status

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_image: Tensor | None, to_alpha: Tensor | None, *_: Any) -> tuple[Tensor | None, ...]:
        """Gradients of projected centers and colors, given those of image and alpha."""
        means2d, colors, counts, *lists_tensors, image, light = ctx.saved_tensors
        lists, size, rows = Lists(*lists_tensors), ctx.size, len(means2d)
        sums = colors.new_empty(size.capacity, kernels.DISC_SUMS.value)
        sums[:rows].zero_()  # what is added to, should the pairs have overflowed
        given = [light if gradient is None else gradient.contiguous() for gradient in (to_image, to_alpha)]
        across, down = tiles_of(size.width, size.height)
        device_kernels.launch(
            kernels.differentiate_discs, across * down, means2d, colors, counts, lists.entries, lists.order,
            lists.places, lists.starts, lists.ends, image, light, *given, sums,
            rows, size.capacity, size.width, size.height, across, size.radius,
            HAS_IMAGE=to_image is not None, HAS_ALPHA=to_alpha is not None, warps=8,
        )  # fmt: skip
        to_colors, to_means2d = torch.empty_like(colors), torch.empty_like(means2d)
        device_kernels.launch(
            kernels.gather_discs, -(-rows // BLOCK), lists.order, lists.ends, counts, sums, to_colors, to_means2d,
            rows, size.capacity, BLOCK=BLOCK,
        )  # fmt: skip
        return None, None, to_means2d, to_colors
