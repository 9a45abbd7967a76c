"""Gaussians bound to triangles: from the local space of a face to the world (GGAvatar Eq. 6–8)."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.acceleration import compiled_for
from ggavatar.geometry import TriangleFrames, matrix_to_quaternion, quaternion_multiply


class Placed(NamedTuple):
    """Geometry of Gaussians in the world."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]


def bind(
    local_means: Float[Tensor, "N 3"],
    local_quats: Float[Tensor, "N 4"],
    local_log_scales: Float[Tensor, "N 3"],
    face_index: Int[Tensor, " N"],
    frames: TriangleFrames,
) -> Placed:
    """Carry Gaussians along with the triangles they are bound to.

    Args:
        local_means: Positions in units of the triangle's size, along its axes.
        local_quats: Rotations relative to the triangle, wxyz, any length but zero.
        local_log_scales: Logarithms of the standard deviations in units of the triangle's size.
        face_index: The triangle of every Gaussian.
        frames: Centres (m), rotations and sizes (m) of the triangles.

    Returns:
        World means (m), unit quaternions and standard deviations (m).

    References:
        GGAvatar (Li et al. 2024), Eq. 6: r' = q(R) r0 as a Hamilton product (docs/paper.md, A3);
        Eq. 7: μ' = S R μ0 + M; Eq. 8: s' = S s0.
    """
    if not compiled_for(local_means, local_quats, local_log_scales, *frames):
        return bind_in_torch(local_means, local_quats, local_log_scales, face_index, frames)
    quats = matrix_to_quaternion(frames.rotations) if frames.rotations.requires_grad else None
    return Placed(*_CompiledBind.apply(local_means, local_quats, local_log_scales, face_index, *frames, quats))


def bind_in_torch(
    local_means: Float[Tensor, "N 3"],
    local_quats: Float[Tensor, "N 4"],
    local_log_scales: Float[Tensor, "N 3"],
    face_index: Int[Tensor, " N"],
    frames: TriangleFrames,
) -> Placed:
    """`bind` in plain torch: any dtype and device, gradients to the frames too."""
    size = frames.scales[face_index, None]
    turned = (frames.rotations[face_index] @ local_means[:, :, None]).squeeze(-1)
    face_quats = matrix_to_quaternion(frames.rotations)[face_index]
    return Placed(
        size * turned + frames.centers[face_index],
        quaternion_multiply(face_quats, normalize(local_quats, dim=-1)),
        size * torch.exp(local_log_scales),
    )


class _CompiledBind(torch.autograd.Function):
    """The compiled kernels of `ggavatar.binding_kernel`; triangles bring their quaternions if these carry gradient."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        from ggavatar import binding_kernel as kernels

        means, quats, log_scales, index, centers, rotations, sizes, face_quats = inputs
        local = kernels.Geometry(*(_array(value) for value in (means, quats, log_scales)))
        ctx.index = index.contiguous().numpy()
        if face_quats is None:
            face_quats = torch.empty(len(centers), 4)
            kernels.quaternions_of(_array(rotations), face_quats.numpy())
        ctx.local, ctx.faces = (
            local,
            kernels.Faces(*(_array(value) for value in (centers, rotations, sizes, face_quats))),
        )
        world = torch.empty(len(means), 3), torch.empty(len(means), 4), torch.empty(len(means), 3)
        ctx.scales = world[2].numpy()
        kernels.place(local, ctx.index, ctx.faces, kernels.Geometry(*(value.numpy() for value in world)))
        return world

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        from ggavatar import binding_kernel as kernels

        wanted = kernels.Geometry(*(_array(value) for value in upstream))
        gradients = [torch.empty(value.shape) for value in ctx.local]
        found = kernels.Geometry(*(value.numpy() for value in gradients))
        kernels.give_back(ctx.local, ctx.index, ctx.faces, wanted, ctx.scales, found)
        to_faces: list[Tensor] | list[None] = [None] * 4
        if any(ctx.needs_input_grad[4:]):
            to_faces = [torch.zeros(value.shape) for value in ctx.faces]
            sums = kernels.Faces(*(value.numpy() for value in to_faces))
            kernels.add_to_faces(ctx.local, ctx.index, ctx.faces, wanted, ctx.scales, sums)
        return *gradients, None, *to_faces


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()
