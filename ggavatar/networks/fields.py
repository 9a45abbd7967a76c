"""Features of canonical positions: a multi-resolution hash tri-plane (GGAvatar H³) and Fourier features.

No gradient flows into positions (docs/paper.md, A11): they are lookup keys in the paper, the gradients of bilinear hash
features are discontinuous, and they would interfere with the learning rate of the local positions.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from numpy import ndarray
from torch import Tensor, nn

from ggavatar.jit import device_kernels
from ggavatar.jit.constants import constant_like
from ggavatar.jit.dispatch import compiled_for

if TYPE_CHECKING:
    from ggavatar.networks import triplane_kernel

PLANES = ((0, 1), (0, 2), (1, 2))
"""The pairs of axes of the three planes: xy, xz, yz."""

PRIME = 2654435761


@runtime_checkable
class Field(Protocol):
    """A function from positions to feature vectors."""

    width: int
    """Number of features."""

    def __call__(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N D"]:
        """Features at `x` (m)."""
        ...


@dataclass(frozen=True)
class Box:
    """An axis-aligned cube in which positions are normalized; points outside are clamped to its surface."""

    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Center, m."""
    side: float = 0.4
    """Length of an edge, m."""

    @staticmethod
    def around(points: Float[Tensor, "V 3"], margin: float = 1.4) -> Box:
        """The cube about the center of the bounding box, `margin` times its longest side (docs/paper.md, A10)."""
        low, high = points.detach().amin(0), points.detach().amax(0)
        center = ((low + high) / 2).tolist()
        return Box((center[0], center[1], center[2]), margin * float((high - low).max()))

    def normalize(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
        """Positions in the box as coordinates in [0, 1]."""
        return ((x - constant_like(self.center, x)) / self.side + 0.5).clamp(0, 1)


@dataclass(frozen=True)
class HashTriplaneConfig:
    """Size of a hash tri-plane; for the defaults see docs/paper.md, A9 (72 features, 1.06 million parameters)."""

    levels: int = 12
    """Number of resolutions, in geometric progression."""
    features: int = 2
    """Features per table entry."""
    base: int = 16
    """Cells along a side at the coarsest level."""
    finest: int = 512
    """Cells along a side at the finest level."""
    log2_size: int = 15
    """Binary logarithm of the largest number of entries of a table; a level that needs more is hashed."""


@dataclass(frozen=True)
class Level:
    """One resolution of a plane."""

    scale: float
    """Cells along a side, minus one."""
    side: int
    """Grid vertices along a side."""
    size: int
    """Entries in the table."""
    offset: int
    """Index of the first entry within the plane's part of the tables."""

    @property
    def hashed(self) -> bool:
        """Whether the table has fewer entries than the grid has vertices."""
        return self.side**2 > self.size


def levels_of(config: HashTriplaneConfig) -> tuple[Level, ...]:
    """The levels of one plane as in tiny-cuda-nn: ⌈base·bⁱ⌉ + 1 vertices a side, sizes rounded up to multiples of 8."""
    growth = (config.finest / config.base) ** (1 / max(config.levels - 1, 1))
    found: list[Level] = []
    offset = 0
    for index in range(config.levels):
        cells = round(config.base * growth**index, 6)
        side = math.ceil(cells) + 1
        size = min(2**config.log2_size, math.ceil(side**2 / 8) * 8)
        found.append(Level(cells - 1, side, size, offset))
        offset += size
    return tuple(found)


class HashTriplane(nn.Module):
    """Multi-resolution hash tables on the planes xy, xz and yz with concatenated bilinear features, as in ER-NeRF.

    Args:
        config: Resolutions and table sizes.
        box: The cube in which positions are normalized.
        generator: Draws the initial entries, uniform in ±1e-4.

    References:
        Müller et al. 2022 (hash encoding); GGAvatar Sec. 3.3.
    """

    def __init__(self, config: HashTriplaneConfig, box: Box, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.box, self.levels = config, box, levels_of(config)
        self.width = len(PLANES) * config.levels * config.features
        entries = sum(level.size for level in self.levels)
        start = torch.rand(len(PLANES) * entries, config.features, generator=generator)
        self.tables = nn.Parameter((2 * start - 1) * 1e-4)

    def forward(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N D"]:
        """Features at `x` (m), plane by plane, level by level; differentiable in the tables only."""
        if self.compiled_at(x):
            return cast(Tensor, _CompiledLookup.apply(kernel_points(self.box, x), self.tables, self.levels))
        if self.config.features == 2 and device_kernels.run_on(x, self.tables):
            return cast(Tensor, _DeviceLookup.apply(x.detach(), self.tables, self.box, self.levels))
        return lookup_in_torch(self.box.normalize(x.detach()), self.tables, self.levels)

    def compiled_at(self, x: Float[Tensor, "N 3"]) -> bool:
        """Whether the compiled kernels support these positions and this configuration."""
        return self.config.features == 2 and compiled_for(x, self.tables)


def lookup_in_torch(
    unit: Float[Tensor, "N 3"], tables: Float[Tensor, "T F"], levels: tuple[Level, ...]
) -> Float[Tensor, "N D"]:
    """Bilinear features of positions in [0, 1]³ in plain torch: any dtype and device."""
    entries = sum(level.size for level in levels)
    found = []
    for plane, axes in enumerate(PLANES):
        for level in levels:
            index, weight = _corners(unit[:, axes[0]], unit[:, axes[1]], level)
            found.append((tables[plane * entries + level.offset + index] * weight[..., None]).sum(1))
    return torch.cat(found, dim=-1)


def _corners(
    u: Float[Tensor, " N"], v: Float[Tensor, " N"], level: Level
) -> tuple[Int[Tensor, "N 4"], Float[Tensor, "N 4"]]:
    """Table entries of the four grid vertices around each point, and their bilinear weights."""
    position = torch.stack((u, v), dim=-1) * level.scale + 0.5
    cell = position.floor()
    fraction = position - cell
    weights, first = torch.stack((1 - fraction, fraction), dim=-1), cell.long()
    vertices = torch.stack((first, first + 1), dim=-1)
    weight = (weights[:, 0, None, :] * weights[:, 1, :, None]).flatten(1)  # (0, 0), (1, 0), (0, 1), (1, 1)
    across, down = vertices[:, 0, None, :], vertices[:, 1, :, None]
    if level.hashed:
        return (across ^ (down * PRIME)).flatten(1) % level.size, weight
    return (across + down * level.side).flatten(1), weight


class _CompiledLookup(torch.autograd.Function):
    """The compiled kernels of `ggavatar.networks.triplane_kernel`."""

    @staticmethod
    def forward(ctx: Any, points: Float32[ndarray, "3 N"], tables: Tensor, levels: tuple[Level, ...]) -> Tensor:
        from ggavatar.networks import triplane_kernel

        ctx.points, ctx.layout, ctx.shape = points, kernel_layout(levels), tables.shape
        features = torch.empty(points.shape[1], len(PLANES) * len(levels) * triplane_kernel.FEATURES)
        triplane_kernel.look_up(ctx.points, tables.detach().contiguous().numpy(), ctx.layout, features.numpy())
        return features

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[None, Tensor, None]:
        from ggavatar.networks import triplane_kernel

        gradient = torch.zeros(ctx.shape)
        triplane_kernel.backward(ctx.points, upstream.contiguous().numpy(), ctx.layout, gradient.numpy())
        return None, gradient, None


class _DeviceLookup(torch.autograd.Function):
    """The kernels of `ggavatar.networks.triplane_triton`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, tables: Tensor, box: Box, levels: tuple[Level, ...]) -> Tensor:
        from ggavatar.networks import triplane_triton as kernels

        x, tables = x.contiguous(), tables.detach().contiguous()
        ctx.save_for_backward(x, tables)
        ctx.cube, ctx.layout = kernels.Cube(*box.center, box.side), _layout_on(levels, x.device)
        return kernels.look_up(x, ctx.cube, tables, ctx.layout)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[None, Tensor, None, None]:
        from ggavatar.networks import triplane_triton as kernels

        x, tables = ctx.saved_tensors
        return None, kernels.backward(x, ctx.cube, upstream.contiguous(), ctx.layout, tables), None, None


@functools.cache
def _layout_on(levels: tuple[Level, ...], device: torch.device) -> Any:
    """The levels of all three planes on a device, where they stay."""
    from ggavatar.networks import triplane_triton

    return triplane_triton.device_layout(kernel_layout(levels), device)


def kernel_points(box: Box, x: Float[Tensor, "N 3"]) -> Float32[ndarray, "3 N"]:
    """`box.normalize(x)` for the kernels; NaN becomes 0, so that it is a valid index."""
    from ggavatar.networks import triplane_kernel

    points = np.empty((3, len(x)), np.float32)
    triplane_kernel.normalize(
        x.detach().contiguous().numpy(), np.array(box.center, np.float32), np.float32(box.side), points
    )
    return points


@functools.cache
def kernel_layout(levels: tuple[Level, ...]) -> triplane_kernel.Layout:
    """The levels of all three planes, for the kernels."""
    from ggavatar.networks import triplane_kernel

    entries = sum(level.size for level in levels)
    every = [(plane, level) for plane in range(len(PLANES)) for level in levels]
    return triplane_kernel.Layout(
        axes=np.array([PLANES[plane] for plane, _ in every], np.int64),
        scale=np.array([level.scale for _, level in every], np.float32),
        side=np.array([level.side for _, level in every], np.uint32),
        mask=np.array([level.size - 1 if level.hashed else 0 for _, level in every], np.uint32),
        first=np.array([plane * entries + level.offset for plane, level in every], np.uint32),
    )


class FourierFeatures(nn.Module):
    """x and sin, cos of 2ᵏπx with x in [−1, 1] within the box (for the ablation without the tri-plane).

    References:
        Mildenhall et al. 2020, Eq. 4 (with the factor π); docs/paper.md, ablations.
    """

    def __init__(self, box: Box, octaves: int = 10) -> None:
        super().__init__()
        self.box, self.octaves = box, octaves
        self.width = 3 + 6 * octaves

    def forward(self, x: Float[Tensor, "N 3"]) -> Float[Tensor, "N D"]:
        """Features at `x` (m): x, then sine and cosine of every octave, without gradient."""
        signed = 2 * self.box.normalize(x.detach()) - 1
        frequencies = math.pi * 2.0 ** torch.arange(self.octaves, device=x.device, dtype=x.dtype)
        angles = signed[:, None, :] * frequencies[:, None]
        return torch.cat((signed, torch.cat((angles.sin(), angles.cos()), dim=-1).flatten(1)), dim=-1)
