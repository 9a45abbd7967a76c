"""The rasteriser that training uses on a CPU: compiled kernels over 16-lane vectors behind one autograd function.

Same numerics as `ggavatar.render.reference` in float32; bit-identical results for any number of threads. Pieces of work are of
fixed size, every sum has a place and an order of its own, and nothing is added atomically.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from ggavatar.compiled import share, workers
from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.errors import InputError
from ggavatar.render.binning import Bins, count_tiles, fill_tiles, sort_by_depth
from ggavatar.render.blending import TILE, TILES_PER_TICKET
from ggavatar.render.checks import FIELDS, camera_tensors, check_finite, check_shapes
from ggavatar.render.constants import CLAMP_MARGIN
from ggavatar.render.cpu_backward import BACKWARD_SCRATCH, SUMS, Incoming, differentiate_tiles
from ggavatar.render.cpu_forward import BATCH, FORWARD_SCRATCH, Canvas, draw_tiles
from ggavatar.render.cpu_gradient import GRADIENT_SCRATCH, POSE_SUMS, Gradients, differentiate_chunks
from ggavatar.render.cpu_harmonics import SCRATCH
from ggavatar.render.cpu_projection import CHECKED, CHUNK, RECORD, Footprints, project_chunks
from ggavatar.render.cpu_shapes import Cloud
from ggavatar.render.harmonics import used_degree


def rasterize(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
    """Draw Gaussians on a constant background.

    Args:
        gaussians: On the CPU; other dtypes than float32 and non-contiguous tensors are converted.
        camera: Differentiable in `world_to_camera`, not in `intrinsics`.
        background: sRGB, differentiable.

    Returns:
        The rendering in float32.

    Raises:
        InputError: Shapes do not fit, a tensor holds NaN or infinity, or `intrinsics` asks for a gradient.
    """
    check_shapes(gaussians, camera, background)
    check_finite(camera_tensors(camera, background))
    if camera.intrinsics.requires_grad:
        raise InputError("camera.intrinsics: the cpu rasteriser gives them no gradient; detach them or use the reference")
    colors = gaussians.colors
    degree = used_degree(colors.shape[1], gaussians.sh_degree) if colors.ndim == 3 else -1
    means2d = _padded(gaussians.means.shape[0], 2).requires_grad_(torch.is_grad_enabled())
    lens = Lens(camera.intrinsics.detach().double().numpy(), camera.width, camera.height, degree)
    inputs = [_plain(getattr(gaussians, name)) for name in FIELDS]
    drawn = _Rasterize.apply(lens, means2d, _plain(camera.world_to_camera), _plain(background), *inputs)
    return Rendering(*drawn[:3], means2d, drawn[3])


class Lens(NamedTuple):
    """What is constant for autograd; `degree` is −1 for RGB."""

    intrinsics: np.ndarray
    width: int
    height: int
    degree: int


def _plain(tensor: Tensor) -> Tensor:
    return tensor.to(torch.float32).contiguous()


def _flat(tensor: Tensor) -> np.ndarray:
    return tensor.detach().reshape(-1).numpy()


def _padded(count: int, *columns: int) -> Tensor:
    """An uninitialised tensor of `count` rows in memory for a multiple of sixteen."""
    return torch.empty(-(-count // 16) * 16, *columns)[:count]


def _memory(tensor: Tensor) -> np.ndarray:
    """All the memory behind a tensor made by `_padded`, as a flat array."""
    base = tensor._base if tensor._base is not None else tensor
    return _flat(base)


class _Rasterize(torch.autograd.Function):
    """(means2d, pose, background, Gaussians) → image, alpha, depth, radii; `means2d` is filled on the way."""

    @staticmethod
    def forward(ctx: Any, lens: Lens, means2d: Tensor, pose: Tensor, background: Tensor, *inputs: Tensor) -> tuple[Tensor, ...]:
        view = view_array(lens, pose, background)
        cloud = cloud_of(inputs, lens.degree)
        radii = _padded(len(means2d))
        footprints = project_all(cloud, view, _memory(means2d), _memory(radii))
        if not np.isfinite(footprints.faults).all():
            check_finite({f"gaussians.{name}": tensor for name, tensor in zip(FIELDS, inputs, strict=True)})
        bins = bin_all(footprints, view)
        tensors, canvas = new_canvas(view, bins)
        draw_all(bins, footprints.records, view, canvas)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(radii)
        ctx.save_for_backward(pose, background, *inputs, *tensors)
        ctx.lens, ctx.view, ctx.footprints, ctx.bins, ctx.hits, ctx.ends = lens, view, footprints, bins, canvas.hits, canvas.ends
        image, light, depth = (tensor[: lens.height, : lens.width].contiguous() for tensor in tensors)
        return image, 1 - light, depth, radii

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *incoming: Tensor | None) -> tuple[Tensor | None, ...]:
        pose, background, *rest = ctx.saved_tensors
        inputs, tensors = rest[:5], rest[5:]
        outputs = [_flat(tensor) for tensor in tensors]
        canvas = Canvas(*outputs, ctx.hits, ctx.ends)
        arriving = [_whole_tiles(gradient, tensor) for gradient, tensor in zip(incoming[:3], tensors, strict=True)]
        cloud = cloud_of(inputs, ctx.lens.degree)
        results, poses = differentiate_all(cloud, ctx.view, ctx.footprints, ctx.bins, canvas, Incoming(*map(_flat, arriving)))
        means, quats, scales, opacities, colors, means2d = results
        backdrop = background_gradient(arriving[0], tensors[1]) if ctx.needs_input_grad[3] else None
        return None, means2d, pose_gradient(pose, poses), backdrop, means, quats, scales, opacities, colors.view_as(inputs[4])


def _whole_tiles(gradient: Tensor | None, like: Tensor) -> Tensor:
    """The gradient in float32, padded with zeros to the size of `like`."""
    if gradient is None:
        return torch.zeros_like(like)
    bottom, right = like.shape[0] - gradient.shape[0], like.shape[1] - gradient.shape[1]
    return _plain(torch.nn.functional.pad(gradient, (0, 0, 0, right, 0, bottom)) if bottom or right else gradient)


def view_array(lens: Lens, pose: Tensor, background: Tensor) -> np.ndarray:
    """A camera and a background as the flat array that kernels read."""
    k, transform = lens.intrinsics, pose.detach().double().numpy()
    focal, principal, size = k[[0, 1], [0, 1]], k[:2, 2], np.array([lens.width, lens.height])
    margin = CLAMP_MARGIN * 0.5 * size / focal
    limits = np.stack((-principal / focal - margin, (size - principal) / focal + margin), axis=1)
    center = -transform[:3, :3].T @ transform[:3, 3]
    tiles = -(-size // TILE)
    parts = (transform[:3, :3], transform[:3, 3], focal, principal, limits, center, size, tiles, background.detach().numpy())
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)


def cloud_of(inputs: Sequence[Tensor], degree: int) -> Cloud:
    """The input tensors as flat arrays."""
    coefficients = inputs[4].shape[1] if inputs[4].ndim == 3 else 0
    means, quats, scales, opacities, colors = (_flat(tensor) for tensor in inputs)
    return Cloud(means, quats, scales, opacities, colors, opacities.size, coefficients, degree)


def project_all(cloud: Cloud, view: np.ndarray, means2d: np.ndarray, radii: np.ndarray) -> Footprints:
    """Project all Gaussians."""
    rows, chunks = radii.size, -(-cloud.count // CHUNK)
    boxes, faults = np.empty(4 * rows, np.int16), np.zeros(chunks * CHECKED, np.float32)
    footprints = Footprints(_scratch(RECORD * rows), means2d, radii, boxes, faults)
    share(project_chunks, chunks, _scratch(workers() * SCRATCH), cloud, view, footprints)
    return footprints


def bin_all(footprints: Footprints, view: np.ndarray) -> Bins:
    """Sort the visible Gaussians into tiles."""
    tiles_x, tiles = int(view[25]), int(view[25]) * int(view[26])
    starts, slots = np.empty(tiles + 1, np.int64), np.empty(footprints.radii.size + 1, np.int64)
    seen = count_tiles(footprints.boxes, tiles_x, starts, slots)
    order = sort_by_depth(footprints.records, slots, np.empty(seen, np.int64), np.empty(seen, np.int64))
    bins = Bins(starts, np.empty(2 * starts[-1], np.int32), slots)
    fill_tiles(order, footprints.boxes, tiles_x, bins)
    return bins


def new_canvas(view: np.ndarray, bins: Bins) -> tuple[tuple[Tensor, Tensor, Tensor], Canvas]:
    """Tensors for image, light and depth in whole tiles, and the canvas over their memory."""
    width, height = int(view[25]) * TILE, int(view[26]) * TILE
    tensors = torch.empty(height, width, 3), torch.empty(height, width, 1), torch.empty(height, width, 1)
    hits, ends = np.empty(bins.entries.size // 2, np.uint16), np.empty(bins.starts.size - 1, np.int64)
    return tensors, Canvas(*map(_flat, tensors), hits, ends)


def draw_all(bins: Bins, records: np.ndarray, view: np.ndarray, canvas: Canvas) -> None:
    """Draw all tiles."""
    masks = np.empty(workers() * BATCH, np.uint16)
    share(draw_tiles, -(-canvas.ends.size // TILES_PER_TICKET), _scratch(workers() * FORWARD_SCRATCH), masks, bins, records, view, canvas)


def differentiate_all(
    cloud: Cloud, view: np.ndarray, footprints: Footprints, bins: Bins, canvas: Canvas, incoming: Incoming
) -> tuple[tuple[Tensor, ...], np.ndarray]:
    """Gradients of means, quats, scales, opacities, colours and image positions, and sums for the pose."""
    count, chunks = cloud.count, -(-cloud.count // CHUNK)
    slots = _scratch(SUMS * canvas.hits.size)
    pieces, scratches = -(-canvas.ends.size // TILES_PER_TICKET), _scratch(workers() * BACKWARD_SCRATCH)
    share(differentiate_tiles, pieces, scratches, bins, footprints.records, view, canvas, incoming, slots)
    results = tuple(_padded(count, *columns) for columns in ((3,), (4,), (3,), ())) + (torch.empty(cloud.colors.size), _padded(count, 2))
    poses = np.zeros((chunks, POSE_SUMS), np.float32)
    gradients = Gradients(*map(_memory, results), poses.reshape(-1))
    share(differentiate_chunks, chunks, _scratch(workers() * GRADIENT_SCRATCH), cloud, view, footprints, bins, slots, gradients)
    return results, poses


def _scratch(size: int) -> np.ndarray:
    """Uninitialised floats; torch aligns them to cache lines, numpy would not."""
    return torch.empty(size).numpy()


def pose_gradient(pose: Tensor, poses: np.ndarray) -> Tensor:
    """Gradient of `world_to_camera`, given sums per chunk for its rotation, its translation and the camera centre −Rᵀ t."""
    sums, transform = poses.astype(np.float64).sum(0), pose.double().numpy()
    center = sums[12:]
    gradient = np.zeros((4, 4))
    gradient[:3, :3] = sums[:9].reshape(3, 3) - np.outer(transform[:3, 3], center)
    gradient[:3, 3] = sums[9:12] - transform[:3, :3] @ center
    return torch.from_numpy(gradient.astype(np.float32))


def background_gradient(image: Tensor, light: Tensor) -> Tensor:
    """Sum over the pixels of gradient times remaining light, in one thread and so always in the same order."""
    incoming, remaining = image.reshape(-1, 3).double().numpy(), light.reshape(-1).double().numpy()
    return torch.from_numpy(np.einsum("pc,p->c", incoming, remaining).astype(np.float32))
