"""Local frames of triangles: position, orientation and size."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.jit import device_kernels
from ggavatar.jit.constants import constant_like
from ggavatar.jit.dispatch import compiled_for


class TriangleFrames(NamedTuple):
    """Local frames of triangles (GGAvatar Eq. 4–5): centers in m, rotation matrices, and sizes in m."""

    centers: Float[Tensor, "F 3"]
    rotations: Float[Tensor, "F 3 3"]
    scales: Float[Tensor, " F"]


def triangle_frames(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> TriangleFrames:
    """Centroid, orientation and size of every triangle.

    Edges a10 and a20 start at the first corner. The columns of the rotation are n0 = unit(a10), n1 = the unit normal
    and n2 = n0 × n1. The size is (|a10| + |n2·a20|) / 2, the mean of an edge and the height over it. The paper prints
    |a20| for the edge; docs/paper.md (A1) says why |a10| is used.

    Args:
        vertices: Positions, m.
        faces: Vertex indices, counter-clockwise seen from outside.

    Returns:
        Centers in m, rotations with determinant 1, and sizes in m. A triangle without area gets a valid rotation and
        half its edge's length as size.

    References:
        GGAvatar (Li et al. 2024), Eq. 4–5; GaussianAvatars (Qian et al. 2024), Sec. 3.2.
    """
    if vertices.requires_grad and torch.is_grad_enabled():
        return triangle_frames_torch(vertices, faces)
    count, on_device = len(faces), device_kernels.run_on(vertices, faces)
    if not (on_device or compiled_for(vertices, faces)):
        return triangle_frames_torch(vertices, faces)
    frames = TriangleFrames(vertices.new_empty(count, 3), vertices.new_empty(count, 3, 3), vertices.new_empty(count))
    if on_device:
        from ggavatar.geometry import triangles_triton

        triangles_triton.fill_frames(vertices.detach().contiguous(), faces.contiguous(), *frames)
        return frames
    from ggavatar.geometry.triangles_kernel import fill_frames

    fill_frames(
        *(value.detach().contiguous().numpy() for value in (vertices, faces)), *(part.numpy() for part in frames)
    )
    return frames


def triangle_frames_torch(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> TriangleFrames:
    """`triangle_frames` in plain torch: any dtype and device, differentiable."""
    # The gradient of `vertices[faces]` would be added by several threads in any order; this one is added in order.
    corner_0, corner_1, corner_2 = vertices.index_select(0, faces.flatten()).unflatten(0, faces.shape).unbind(1)
    edge_10, edge_20 = corner_1 - corner_0, corner_2 - corner_0
    length = edge_10.norm(dim=-1)
    axis_0 = _unit_or(edge_10, (1.0, 0.0, 0.0))
    fallback = torch.linalg.cross(axis_0, axis_0.roll(1, -1) + constant_like((0.3, -0.2, 0.1), axis_0))
    axis_1 = _unit_or(torch.linalg.cross(axis_0, edge_20), fallback)
    axis_1 = normalize(axis_1 - (axis_1 * axis_0).sum(-1, keepdim=True) * axis_0, dim=-1)
    axis_2 = torch.linalg.cross(axis_0, axis_1)
    height = (axis_2 * edge_20).sum(-1).abs()
    centers = (corner_0 + corner_1 + corner_2) / 3
    return TriangleFrames(centers, torch.stack((axis_0, axis_1, axis_2), dim=-1), (length + height) / 2)


def _unit_or(vectors: Tensor, fallback: Tensor | tuple[float, ...]) -> Tensor:
    """Normalize vectors, substituting `fallback` (normalized) where the length is zero."""
    length = vectors.norm(dim=-1, keepdim=True)
    other = fallback if isinstance(fallback, Tensor) else constant_like(fallback, vectors)
    return torch.where(length > 1e-20, vectors / length.clamp_min(1e-20), normalize(other, dim=-1).expand_as(vectors))
