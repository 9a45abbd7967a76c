"""Offsets of Gaussians and the refined ⊕ that applies them (GGAvatar Eq. 11–12)."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.geometry.transforms import quaternion_multiply
from ggavatar.jit.dispatch import compiled_for
from ggavatar.jit.padding import memory_of, padded

COLOUR = 10
"""Column of the first color row, if there are any."""


class Offsets(NamedTuple):
    """The product W·f of every Gaussian, without units; several conditions add a leading axis.

    Attributes:
        rows: Position 3, rotation 4 and log-scale 3; with color 3 more.
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
        return self.rows[..., 7:COLOUR]

    @property
    def colors(self) -> Float[Tensor, "*B N 3"] | None:
        """Color offsets, if the basis has rows for them."""
        return self.rows[..., COLOUR:] if self.rows.shape[-1] > COLOUR else None


class Refined(NamedTuple):
    """Refined geometry in the world: m, unit quaternions wxyz, m."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]


def refine(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    offsets: Offsets,
    unit: float = 0.01,
    rotation: Literal["product", "add"] = "product",
) -> Refined:
    """The refined ⊕ of Eq. 12; zero offsets leave everything as it is.

    Args:
        means: Positions carried by the mesh, m.
        quats: Unit quaternions carried by the mesh, wxyz.
        scales: Standard deviations carried by the mesh, m.
        offsets: W·f of one condition.
        unit: Meters per unit of the position offset (docs/paper.md, A6).
        rotation: "product" turns by the unit quaternion of (1, 0, 0, 0) + Δr in world axes, whatever the sign of
            `quats` (A4); "add" adds Δr to the quaternion and normalizes, as TalkingGaussian does.

    Returns:
        Means + unit·Δμ, unit quaternions, and scales · exp(Δs) (A5).
    """
    if rotation == "product" and compiled_for(means, quats, scales, offsets.rows):
        return Refined(*_CompiledRefine.apply(means, quats, scales, offsets.rows, unit))
    return refine_in_torch(means, quats, scales, offsets, unit, rotation)


def refine_in_torch(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    offsets: Offsets,
    unit: float = 0.01,
    rotation: Literal["product", "add"] = "product",
) -> Refined:
    """`refine` in plain torch: any dtype and device."""
    if rotation == "add":
        turned = normalize(quats + offsets.rotations, dim=-1)
    else:
        identity = quats.new_tensor([1.0, 0.0, 0.0, 0.0])
        turned = quaternion_multiply(normalize(identity + offsets.rotations, dim=-1), quats)
    return Refined(means + unit * offsets.means, turned, scales * torch.exp(offsets.log_scales))


class _CompiledRefine(torch.autograd.Function):
    """The compiled kernels of `ggavatar.gaussians.offsets_kernel`."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        from ggavatar.gaussians import offsets_kernel as kernels

        *placed, rows, ctx.unit = inputs
        ctx.placed = kernels.Geometry(*(_array(value) for value in placed))
        ctx.rows = _array(rows)
        refined = tuple(padded(*value.shape) for value in placed)
        kernels.refine(ctx.placed, ctx.rows, ctx.unit, kernels.Geometry(*(memory_of(value) for value in refined)))
        return refined

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        from ggavatar.gaussians import offsets_kernel as kernels

        _, quats, scales = (padded(*value.shape) for value in upstream)
        to_rows = torch.zeros(ctx.rows.shape)
        wanted = kernels.Geometry(*(_array(value) for value in upstream))
        found = kernels.Geometry(wanted.means, memory_of(quats), memory_of(scales))
        kernels.give_back(ctx.placed, ctx.rows, ctx.unit, wanted, found, to_rows.numpy())
        return upstream[0], quats, scales, to_rows, None


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()
