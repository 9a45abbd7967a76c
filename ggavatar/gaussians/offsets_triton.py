"""The operator ⊕ of Eq. 12, and its gradient, in Triton (torch twin: `offsets.refine_in_torch`)."""

from __future__ import annotations

import torch
import triton.language as tl
from torch import Tensor

from ggavatar.gaussians.binding_triton import Geometry
from ggavatar.jit import device_kernels
from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import (
    combined,
    conjugate,
    hamilton,
    load_3,
    load_4,
    normalized,
    product,
    scaled,
    store_3,
    store_4,
    through_normalized,
)

BLOCK = 128


@device_function
def _load(offsets, row, WIDTH: tl.constexpr, FIRST: tl.constexpr, alive):
    """Three consecutive offsets of every Gaussian."""
    at = offsets + row * WIDTH + FIRST
    second = tl.load(at + 1, mask=alive, other=0.0)
    return tl.load(at, mask=alive, other=0.0), second, tl.load(at + 2, mask=alive, other=0.0)


@device_function
def _store(offsets, row, WIDTH: tl.constexpr, FIRST: tl.constexpr, alive, a):
    """Write three consecutive offsets of every Gaussian."""
    at = offsets + row * WIDTH + FIRST
    tl.store(at, a[0], mask=alive)
    tl.store(at + 1, a[1], mask=alive)
    tl.store(at + 2, a[2], mask=alive)


@device_function
def _turn(offsets, row, WIDTH: tl.constexpr, alive):
    """The unit quaternion of (1, 0, 0, 0) + Δr, and 1 / its length."""
    real = 1 + tl.load(offsets + row * WIDTH + 3, mask=alive, other=0.0)
    x, y, z = _load(offsets, row, WIDTH, 4, alive)
    return normalized((real, x, y, z))


@device_function
def _growth(offsets, row, WIDTH: tl.constexpr, alive):
    """exp(Δs)."""
    x, y, z = _load(offsets, row, WIDTH, 7, alive)
    return tl.exp(x), tl.exp(y), tl.exp(z)


@device_kernel
def refine_gaussians(
    means, quats, scales, offsets, refined_means, refined_quats, refined_scales,
    rows, unit,
    WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write means + unit·Δμ, the rotation (1, 0, 0, 0) + Δr from the left, and scales · exp(Δs)."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    moved = combined(1.0, load_3(means, row, alive), unit, _load(offsets, row, WIDTH, 0, alive))
    store_3(refined_means, row, alive, moved)
    turn, _ = _turn(offsets, row, WIDTH, alive)
    store_4(refined_quats, row, alive, hamilton(turn, load_4(quats, row, alive)))
    store_3(refined_scales, row, alive, product(load_3(scales, row, alive), _growth(offsets, row, WIDTH, alive)))


@device_kernel
def differentiate_refinement(
    quats, scales, offsets, from_means, from_quats, from_scales, to_quats, to_scales, to_offsets,
    rows, unit,
    WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the gradients of quaternions, scales and offsets; that of the means is the upstream one."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = row < rows
    grown = product(load_3(from_scales, row, alive), _growth(offsets, row, WIDTH, alive))
    store_3(to_scales, row, alive, grown)
    turn, inverse = _turn(offsets, row, WIDTH, alive)
    given = load_4(from_quats, row, alive)
    store_4(to_quats, row, alive, hamilton(conjugate(turn), given))
    to_unit = hamilton(given, conjugate(load_4(quats, row, alive)))
    to_w, to_x, to_y, to_z = through_normalized(to_unit, turn, inverse)
    _store(to_offsets, row, WIDTH, 0, alive, scaled(unit, load_3(from_means, row, alive)))
    tl.store(to_offsets + row * WIDTH + 3, to_w, mask=alive)
    _store(to_offsets, row, WIDTH, 4, alive, (to_x, to_y, to_z))
    _store(to_offsets, row, WIDTH, 7, alive, product(grown, load_3(scales, row, alive)))
    for column in tl.static_range(10, WIDTH):  # of colors
        tl.store(to_offsets + row * WIDTH + column, tl.zeros([BLOCK], tl.float32), mask=alive)


def refine(bound: Geometry, offsets: Tensor, unit: float) -> Geometry:
    """The refined geometry of all Gaussians."""
    refined = Geometry(*(torch.empty_like(part) for part in bound))
    rows, width = offsets.shape
    tensors = *bound, offsets, *refined
    device_kernels.launch(refine_gaussians, -(-rows // BLOCK), *tensors, rows, unit, WIDTH=width, BLOCK=BLOCK)
    return refined


def backward(bound: Geometry, offsets: Tensor, unit: float, upstream: Geometry) -> tuple[Tensor, Tensor, Tensor]:
    """The gradients of quaternions, scales and offsets."""
    rows, width = offsets.shape
    found = torch.empty_like(bound.quats), torch.empty_like(bound.scales), torch.empty_like(offsets)
    tensors = bound.quats, bound.scales, offsets, *upstream, *found
    device_kernels.launch(differentiate_refinement, -(-rows // BLOCK), *tensors, rows, unit, WIDTH=width, BLOCK=BLOCK)
    return found
