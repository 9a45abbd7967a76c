"""The stages of the compiled rasterizer; each allocates memory and runs a kernel on all threads.

Memory is filled by numpy and our own threads, because torch's parallel loops would hang in a forked child.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ggavatar.jit.padding import flat, memory_of, padded
from ggavatar.jit.threads import max_workers, run, run_workers
from ggavatar.render.constants import CLAMP_MARGIN
from ggavatar.render.cpu.backward import BACKWARD_SCRATCH, SUMS, SUMS_READ, Incoming, differentiate_tiles
from ggavatar.render.cpu.binning import Bins, count_tiles, fill_tiles, sort_by_depth
from ggavatar.render.cpu.blending import TILES_PER_TICKET
from ggavatar.render.cpu.forward import BATCH, FORWARD_SCRATCH, Canvas, draw_tiles
from ggavatar.render.cpu.gradient import GRADIENT_SCRATCH, POSE_SUMS, Gradients, differentiate_chunks
from ggavatar.render.cpu.harmonics import SCRATCH
from ggavatar.render.cpu.layout import RECORD, TILE, TILES, Cloud
from ggavatar.render.cpu.projection import CHECKED_TENSORS, CHUNK, Footprints, color_chunks, project_chunks


class ViewConstants(NamedTuple):
    """What autograd treats as constant: intrinsics, image size in px, and the harmonics' degree (−1 for RGB)."""

    intrinsics: np.ndarray
    width: int
    height: int
    degree: int


def _floats(size: int) -> np.ndarray:
    """Uninitialized floats, which torch aligns to cache lines and numpy would not."""
    return torch.empty(size).numpy()


def cropped(tensor: Tensor, constants: ViewConstants) -> Tensor:
    """Crop a tensor of whole tiles to the image."""
    if tensor.shape[:2] == (constants.height, constants.width):
        return tensor
    return torch.from_numpy(np.ascontiguousarray(tensor.numpy()[: constants.height, : constants.width]))


def whole_tiles(gradient: Tensor | None, like: Tensor) -> Tensor:
    """The gradient in float32, padded with zeros to the shape of `like`; all zeros for None."""
    if gradient is not None and gradient.shape == like.shape:
        return gradient.to(torch.float32).contiguous()
    whole = np.empty(like.shape, np.float32)
    whole.fill(0)
    if gradient is not None:
        whole[: gradient.shape[0], : gradient.shape[1]] = gradient.numpy()
    return torch.from_numpy(whole)


def view_array(constants: ViewConstants, pose: Tensor, background: Tensor) -> np.ndarray:
    """Pack a camera and a background into the array that kernels read (offsets: `ggavatar.render.cpu.layout`)."""
    k, transform = constants.intrinsics, pose.detach().double().numpy()
    focal, principal, size = k[[0, 1], [0, 1]], k[:2, 2], np.array([constants.width, constants.height])
    margin = CLAMP_MARGIN * 0.5 * size / focal
    limits = np.stack((-principal / focal - margin, (size - principal) / focal + margin), axis=1)
    rotation, translation = transform[:3, :3], transform[:3, 3]
    tiles, backdrop = -(-size // TILE), background.detach().numpy()
    parts = rotation, translation, focal, principal, limits, -rotation.T @ translation, size, tiles, backdrop
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)


def project_all(cloud: Cloud, view: np.ndarray, means2d: Tensor, radii: Tensor) -> Footprints:
    """Project all Gaussians, without colors; writes `means2d` and `radii`."""
    sizes, chunks = memory_of(radii), -(-cloud.rows // CHUNK)
    boxes, faults = np.empty(4 * sizes.size, np.int16), np.zeros(chunks * CHECKED_TENSORS, np.float32)
    footprints = Footprints(_floats(RECORD * sizes.size), memory_of(means2d), sizes, boxes, faults)
    run_workers(project_chunks, chunks, cloud, view, footprints)
    return footprints


def bin_and_color(cloud: Cloud, view: np.ndarray, footprints: Footprints) -> Bins:
    """Sort the visible Gaussians into tiles while other threads write the colors into the records."""
    tickets, scratches, bins = np.zeros(2, np.int64), _floats(max_workers() * SCRATCH), []

    def task(index: int) -> None:
        if index == 0:
            bins.append(bin_all(footprints, view))
        color_chunks(tickets, scratches, cloud, view, footprints)

    run(task, max_workers())
    return bins[0]


def bin_all(footprints: Footprints, view: np.ndarray) -> Bins:
    """Sort the visible Gaussians into tiles."""
    tiles_x, tiles = int(view[TILES]), int(view[TILES]) * int(view[TILES + 1])
    starts, slots = np.empty(tiles + 1, np.int64), np.empty(footprints.radii.size + 1, np.int64)
    seen = count_tiles(footprints.boxes, tiles_x, starts, slots)
    order = sort_by_depth(footprints.records, slots, np.empty(seen, np.int64), np.empty(seen, np.int64))
    bins = Bins(starts, np.empty(2 * starts[-1], np.int32), slots)
    fill_tiles(order, footprints.boxes, tiles_x, bins)
    return bins


def draw_all(
    bins: Bins, records: np.ndarray, view: np.ndarray
) -> tuple[tuple[Tensor, Tensor, Tensor, Tensor], np.ndarray, np.ndarray]:
    """Draw all tiles; returns image, transmittance, depth and alpha in whole tiles, and the canvas's hits and ends."""
    width, height, tiles = int(view[TILES]) * TILE, int(view[TILES + 1]) * TILE, bins.starts.size - 1
    image, transmittance, depth, alpha = (torch.empty(height, width, channels) for channels in (3, 1, 1, 1))
    hits, ends = np.empty(bins.entries.size // 2, np.uint16), np.empty(tiles, np.int64)
    canvas = Canvas(flat(image), flat(transmittance), flat(depth), flat(alpha), hits, ends)
    scratches, masks = _floats(max_workers() * FORWARD_SCRATCH), np.empty(max_workers() * BATCH, np.uint16)
    run_workers(draw_tiles, -(-tiles // TILES_PER_TICKET), scratches, masks, bins, records, view, canvas)
    return (image, transmittance, depth, alpha), hits, ends


def differentiate_all(
    cloud: Cloud, view: np.ndarray, footprints: Footprints, bins: Bins, canvas: Canvas, incoming: Incoming
) -> tuple[tuple[Tensor, ...], np.ndarray]:
    """Gradients of means, quats, scales, opacities, colors and projected centers, and the sums for the pose."""
    slots, pieces = _floats(SUMS * canvas.hits.size + SUMS_READ), -(-canvas.ends.size // TILES_PER_TICKET)
    scratches = _floats(max_workers() * BACKWARD_SCRATCH)
    run_workers(differentiate_tiles, pieces, scratches, bins, footprints.records, view, canvas, incoming, slots)
    count, chunks = cloud.rows, -(-cloud.rows // CHUNK)
    means, quats, scales, opacities, means2d = (padded(count, *columns) for columns in ((3,), (4,), (3,), (), (2,)))
    colors, poses = torch.empty(cloud.colors.size), np.zeros((chunks, POSE_SUMS), np.float32)
    gradients = Gradients(
        *(memory_of(means), memory_of(quats), memory_of(scales), memory_of(opacities)),
        *(flat(colors), memory_of(means2d), poses.reshape(-1)),
    )
    scratches = _floats(max_workers() * GRADIENT_SCRATCH)
    run_workers(differentiate_chunks, chunks, scratches, cloud, view, footprints, bins, slots, gradients)
    return (means, quats, scales, opacities, colors, means2d), poses.astype(np.float64).sum(0)
