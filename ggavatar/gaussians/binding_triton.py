"""Binding of Gaussians to triangles, and its gradient, in Triton (torch twin: `binding.bind_in_torch`)."""

from __future__ import annotations

from typing import NamedTuple

import torch
import triton.language as tl
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import (
    added,
    combined,
    conjugate,
    dot,
    hamilton,
    load_3,
    load_4,
    normalized,
    product,
    quaternion_of,
    scaled,
    store_3,
    store_4,
    through_normalized,
)

BLOCK = 128


class Geometry(NamedTuple):
    """Means [N, 3], quaternions [N, 4] and scales [N, 3] (logarithms in local space), or their gradients."""

    means: Tensor
    quats: Tensor
    scales: Tensor


class Triangles(NamedTuple):
    """Centers [F, 3], rotations [F, 3, 3] and sizes [F] of triangles."""

    centers: Tensor
    rotations: Tensor
    sizes: Tensor


@device_function
def _rotation(rotations, face, alive):
    """The rows of the triangles' rotations."""
    row_0, row_1 = load_3(rotations, 3 * face, alive), load_3(rotations, 3 * face + 1, alive)
    return row_0, row_1, load_3(rotations, 3 * face + 2, alive)


@device_kernel
def bind_gaussians(
    means, quats, log_scales, index, centers, rotations, sizes, world_means, world_quats, world_scales,
    rows,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the world geometry of Gaussians, `index` being their triangles (GGAvatar Eq. 6–8)."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    face = tl.load(index + row, mask=alive, other=0)
    row_0, row_1, row_2 = _rotation(rotations, face, alive)
    mean, size = load_3(means, row, alive), tl.load(sizes + face, mask=alive, other=0.0)
    turned = (dot(row_0, mean), dot(row_1, mean), dot(row_2, mean))
    store_3(world_means, row, alive, added(scaled(size, turned), load_3(centers, face, alive)))
    unit, _ = normalized(load_4(quats, row, alive))
    store_4(world_quats, row, alive, hamilton(quaternion_of(row_0, row_1, row_2), unit))
    logs = load_3(log_scales, row, alive)
    store_3(world_scales, row, alive, scaled(size, (tl.exp(logs[0]), tl.exp(logs[1]), tl.exp(logs[2]))))


@device_kernel
def differentiate_binding(
    quats, index, rotations, sizes, world_scales, from_means, from_quats, from_scales, to_means, to_quats, to_scales,
    rows,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the gradients of the local geometry, from those of the world geometry."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    face = tl.load(index + row, mask=alive, other=0)
    row_0, row_1, row_2 = _rotation(rotations, face, alive)
    given, size = load_3(from_means, row, alive), tl.load(sizes + face, mask=alive, other=0.0)
    turned_back = added(combined(given[0], row_0, given[1], row_1), scaled(given[2], row_2))
    store_3(to_means, row, alive, scaled(size, turned_back))
    store_3(to_scales, row, alive, product(load_3(from_scales, row, alive), load_3(world_scales, row, alive)))
    unit, inverse = normalized(load_4(quats, row, alive))
    to_unit = hamilton(conjugate(quaternion_of(row_0, row_1, row_2)), load_4(from_quats, row, alive))
    store_4(to_quats, row, alive, through_normalized(to_unit, unit, inverse))


def bind(local: Geometry, index: Tensor, triangles: Triangles) -> Geometry:
    """The world geometry of all Gaussians."""
    world = Geometry(*(torch.empty_like(part) for part in local))
    programs = -(-len(index) // BLOCK)
    device_kernels.launch(bind_gaussians, programs, *local, index, *triangles, *world, len(index), BLOCK=BLOCK)
    return world


def backward(
    local_quats: Tensor, index: Tensor, triangles: Triangles, world_scales: Tensor, upstream: Geometry
) -> Geometry:
    """The gradients of the local geometry."""
    found = Geometry(*(torch.empty_like(part) for part in upstream))
    kept = local_quats, index, triangles.rotations, triangles.sizes, world_scales
    programs = -(-len(index) // BLOCK)
    device_kernels.launch(differentiate_binding, programs, *kept, *upstream, *found, len(index), BLOCK=BLOCK)
    return found
