"""Gaussians bound to triangles: from the local space of their triangle to the world (GGAvatar Eq. 6–8)."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.geometry.transforms import matrix_to_quaternion, quaternion_multiply
from ggavatar.geometry.triangles import TriangleFrames
from ggavatar.jit import device_kernels
from ggavatar.jit.dispatch import compiled_for
from ggavatar.jit.padding import flat, memory_of, padded


class WorldGeometry(NamedTuple):
    """Geometry of Gaussians in the world: means (m), unit quaternions wxyz and standard deviations (m)."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]


def bind(
    local_means: Float[Tensor, "N 3"],
    local_quats: Float[Tensor, "N 4"],
    local_log_scales: Float[Tensor, "N 3"],
    face_index: Int[Tensor, " N"],
    local_frames: TriangleFrames,
) -> WorldGeometry:
    """Transform Gaussians with the triangles that they are bound to.

    Args:
        local_means: Positions in units of the triangle's size, along its axes.
        local_quats: Rotations relative to the triangle, wxyz, of any nonzero length.
        local_log_scales: Logarithms of the standard deviations in units of the triangle's size.
        face_index: The triangle of every Gaussian.
        local_frames: Centers (m), rotations and sizes (m) of the triangles.

    References:
        GGAvatar (Li et al. 2024), Eq. 6: r' = q(R) r0 as a Hamilton product (docs/paper.md, A3);
        Eq. 7: μ' = S R μ0 + M; Eq. 8: s' = S s0.
    """
    given = local_means, local_quats, local_log_scales
    if not any(part.requires_grad for part in local_frames) and device_kernels.run_on(*given, *local_frames):
        return WorldGeometry(*_DeviceBind.apply(*given, face_index, *local_frames))
    if not compiled_for(*given, *local_frames):
        return bind_in_torch(local_means, local_quats, local_log_scales, face_index, local_frames)
    quats = matrix_to_quaternion(local_frames.rotations) if local_frames.rotations.requires_grad else None
    return WorldGeometry(*_CompiledBind.apply(*given, face_index, *local_frames, quats))


def bind_in_torch(
    local_means: Float[Tensor, "N 3"],
    local_quats: Float[Tensor, "N 4"],
    local_log_scales: Float[Tensor, "N 3"],
    face_index: Int[Tensor, " N"],
    local_frames: TriangleFrames,
) -> WorldGeometry:
    """`bind` in plain torch: any dtype and device, with gradients to the triangle frames."""
    size = local_frames.scales[face_index, None]
    turned = (local_frames.rotations[face_index] @ local_means[:, :, None]).squeeze(-1)
    face_quats = matrix_to_quaternion(local_frames.rotations)[face_index]
    return WorldGeometry(
        size * turned + local_frames.centers[face_index],
        quaternion_multiply(face_quats, normalize(local_quats, dim=-1)),
        size * torch.exp(local_log_scales),
    )


class _CompiledBind(torch.autograd.Function):
    """The compiled kernels; the quaternions of the triangles are inputs if gradients must reach them."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        from ggavatar.gaussians import binding_kernel as kernels

        means, quats, log_scales, index, *triangles, face_quats = inputs
        ctx.local = kernels.GeometryArrays(*(_array(value) for value in (means, quats, log_scales)))
        ctx.index, ctx.triangles = index.contiguous().numpy(), tuple(_array(value) for value in triangles)
        ctx.records = kernels.triangle_records(ctx.triangles, None if face_quats is None else _array(face_quats))
        world = _allocate(len(means))
        ctx.scales = flat(world[2])
        kernels.bind(ctx.local, ctx.index, ctx.records, kernels.GeometryArrays(*(memory_of(value) for value in world)))
        return world

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of the local geometry, from those of the world geometry."""
        from ggavatar.gaussians import binding_kernel as kernels

        wanted = kernels.GeometryArrays(*(_array(value) for value in upstream))
        gradients = _allocate(len(ctx.index))
        found = kernels.GeometryArrays(*(memory_of(value) for value in gradients))
        kernels.backward(ctx.local, ctx.index, ctx.records, wanted, ctx.scales, found)
        to_faces: list[Tensor] | list[None] = [None] * 4
        if any(ctx.needs_input_grad[4:]):
            faces = kernels.TriangleArrays(*(*ctx.triangles, kernels.record_quats(ctx.records)))
            to_faces = [torch.zeros(value.shape) for value in faces]
            sums = kernels.TriangleArrays(*(value.numpy() for value in to_faces))
            kernels.add_to_faces(ctx.local, ctx.index, faces, wanted, ctx.scales.reshape(-1, 3), sums)
        return *gradients, None, *to_faces


class _DeviceBind(torch.autograd.Function):
    """The kernels of `ggavatar.gaussians.binding_triton`, without gradients of the triangles."""

    @staticmethod
    def forward(ctx: Any, *inputs: Tensor) -> tuple[Tensor, ...]:
        from ggavatar.gaussians import binding_triton as kernels

        means, quats, log_scales, index, *triangles = (value.detach().contiguous() for value in inputs)
        world = kernels.bind(kernels.Geometry(means, quats, log_scales), index, kernels.Triangles(*triangles))
        ctx.save_for_backward(quats, index, *triangles, world.scales)
        return tuple(world)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        from ggavatar.gaussians import binding_triton as kernels

        quats, index, *triangles, world_scales = ctx.saved_tensors
        given = kernels.Geometry(*(value.contiguous() for value in upstream))
        found = kernels.backward(quats, index, kernels.Triangles(*triangles), world_scales, given)
        return *found, None, None, None, None


def _allocate(count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Uninitialized means, quaternions and scales of `count` Gaussians."""
    return padded(count, 3), padded(count, 4), padded(count, 3)


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()
