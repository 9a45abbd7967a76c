"""Offsets of Gaussians and the operator ⊕ that applies them (GGAvatar Eq. 11–12)."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.gaussians.binding import WorldGeometry
from ggavatar.geometry.transforms import quaternion_multiply
from ggavatar.jit import device_kernels
from ggavatar.jit.constants import constant_like
from ggavatar.jit.dispatch import compiled_for
from ggavatar.jit.padding import memory_of, padded

GEOMETRY_ROWS = 10
"""Rows of an offset for geometry: position 3, rotation 4, log-scale 3."""
COLOR_ROWS = 3
"""Rows of an offset for color, after those for geometry; optional."""


class Offsets(NamedTuple):
    """The product W·f of every Gaussian, dimensionless; several conditions add a leading axis.

    Attributes:
        rows: `GEOMETRY_ROWS` numbers per Gaussian, or `COLOR_ROWS` more.
    """

    rows: Float[Tensor, "*B N R"]

    @property
    def means(self) -> Float[Tensor, "*B N 3"]:
        """Δμ."""
        return self.rows[..., :3]

    @property
    def rotations(self) -> Float[Tensor, "*B N 4"]:
        """Δr."""
        return self.rows[..., 3:7]

    @property
    def log_scales(self) -> Float[Tensor, "*B N 3"]:
        """Δs."""
        return self.rows[..., 7:GEOMETRY_ROWS]

    @property
    def colors(self) -> Float[Tensor, "*B N 3"] | None:
        """Color offsets; None if the basis has no color rows."""
        return self.rows[..., GEOMETRY_ROWS:] if self.rows.shape[-1] > GEOMETRY_ROWS else None


def refine(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    offsets: Offsets,
    unit: float = 0.01,
    rotation: Literal["product", "add"] = "product",
) -> WorldGeometry:
    """The operator ⊕ of Eq. 12, refined; zero offsets change nothing.

    Args:
        means: Positions after binding, m.
        quats: Unit quaternions after binding, wxyz.
        scales: Standard deviations after binding, m.
        offsets: W·f of one condition.
        unit: Meters per unit of the position offset (docs/paper.md, A6).
        rotation: "product" rotates by the unit quaternion of (1, 0, 0, 0) + Δr in world axes, which is independent of
            the sign of `quats` (A4); "add" adds Δr to the quaternion and normalizes, as in TalkingGaussian.

    Returns:
        Means + unit·Δμ, rotated unit quaternions, and scales · exp(Δs) (A5).
    """
    if rotation == "product" and compiled_for(means, quats, scales, offsets.rows):
        return WorldGeometry(*_CompiledRefine.apply(means, quats, scales, offsets.rows, unit))
    if rotation == "product" and device_kernels.run_on(means, quats, scales, offsets.rows):
        return WorldGeometry(*_DeviceRefine.apply(means, quats, scales, offsets.rows, unit))
    return refine_in_torch(means, quats, scales, offsets, unit, rotation)


def refine_in_torch(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    offsets: Offsets,
    unit: float = 0.01,
    rotation: Literal["product", "add"] = "product",
) -> WorldGeometry:
    """`refine` in plain torch: any dtype and device."""
    if rotation == "add":
        turned = normalize(quats + offsets.rotations, dim=-1)
    else:
        identity = constant_like((1.0, 0.0, 0.0, 0.0), quats)
        turned = quaternion_multiply(normalize(identity + offsets.rotations, dim=-1), quats)
    return WorldGeometry(means + unit * offsets.means, turned, scales * torch.exp(offsets.log_scales))


class _CompiledRefine(torch.autograd.Function):
    """The compiled kernels of `ggavatar.gaussians.offsets_kernel`."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        from ggavatar.gaussians import offsets_kernel as kernels

        *bound, rows, ctx.unit = inputs
        ctx.bound = kernels.GeometryArrays(*(_array(value) for value in bound))
        ctx.rows = _array(rows)
        refined = tuple(padded(*value.shape) for value in bound)
        kernels.refine(ctx.bound, ctx.rows, ctx.unit, kernels.GeometryArrays(*(memory_of(value) for value in refined)))
        return refined

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        from ggavatar.gaussians import offsets_kernel as kernels

        _, quats, scales = (padded(*value.shape) for value in upstream)
        to_rows = torch.zeros(ctx.rows.shape)
        wanted = kernels.GeometryArrays(*(_array(value) for value in upstream))
        found = kernels.GeometryArrays(wanted.means, memory_of(quats), memory_of(scales))
        kernels.backward(ctx.bound, ctx.rows, ctx.unit, wanted, found, to_rows.numpy())
        return upstream[0], quats, scales, to_rows, None


class _DeviceRefine(torch.autograd.Function):
    """The kernels of `ggavatar.gaussians.offsets_triton`."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        from ggavatar.gaussians import offsets_triton as kernels

        *bound, rows = (value.detach().contiguous() for value in inputs[:4])
        ctx.unit = inputs[4]
        ctx.save_for_backward(*bound, rows)
        return tuple(kernels.refine(kernels.Geometry(*bound), rows, ctx.unit))

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        from ggavatar.gaussians import offsets_triton as kernels

        *bound, rows = ctx.saved_tensors
        given = kernels.Geometry(*(value.contiguous() for value in upstream))
        return upstream[0], *kernels.backward(kernels.Geometry(*bound), rows, ctx.unit, given), None


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()
