"""Normals and turns of the vertices of a mesh, which vary smoothly over it, unlike those of its triangles."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.geometry.transforms import matrix_to_quaternion
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.jit.constants import constant_like

LEAST_LENGTH = 1e-20
"""Length up to which a sum of vectors or quaternions counts as zero."""


def face_vectors(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "F 3"]:
    """Normals of the triangles, as long as twice their areas (m² for vertices in m)."""
    # The gradient of `vertices[faces]` would be added by several threads in any order; this one is added in order.
    a, b, c = vertices.index_select(0, faces.flatten()).unflatten(0, faces.shape).unbind(1)
    return torch.linalg.cross(b - a, c - a)


def vertex_normals(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], vectors: Float[Tensor, "F 3"] | None = None
) -> Float[Tensor, "V 3"]:
    """Unit normals of the vertices: means over the triangles around, weighted by area; differentiable.

    Args:
        vertices: Positions, m.
        faces: Vertex indices, counter-clockwise seen from outside.
        vectors: `face_vectors`, if they are known.

    Returns:
        Unit normals, outward; +Y for vertices whose triangles have no area, or cancel out.

    References:
        Area weights: Shao et al. 2024 (by PyTorch3D); the alternatives are compared in Jin et al. 2005.
    """
    vectors = face_vectors(vertices, faces) if vectors is None else vectors
    return _unit_or(_summed(vectors, faces, len(vertices)), (0.0, 1.0, 0.0))


class RestFrames(NamedTuple):
    """What `vertex_turns` needs of the mesh at rest.

    Attributes:
        rotations: Axes of the triangles.
        areas: Areas of the triangles, m².
    """

    rotations: Float[Tensor, "F 3 3"]
    areas: Float[Tensor, " F"]

    @staticmethod
    def of(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> RestFrames:
        """The frames of a mesh with these vertices, m."""
        areas = face_vectors(vertices, faces).norm(dim=-1) / 2
        return RestFrames(triangle_frames(vertices, faces).rotations, areas)


def vertex_turns(rest: RestFrames, vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "V 4"]:
    """How each vertex has turned from rest: means of the turns of the triangles around, weighted by area at rest.

    A triangle turns by R = T(posed) T(rest)ᵀ. Its quaternion is taken with a nonnegative real part, so that turns of
    less than 180° never cancel by sign.

    Returns:
        Unit quaternions wxyz; the identity for vertices whose triangles have no area, or cancel out.

    References:
        Shao et al. 2024, Eq. 4–6, and their code, utils/map.py. Eq. 4 prints the inverse of R, which would turn
        Gaussians backward.
    """
    turns = triangle_frames(vertices, faces).rotations @ rest.rotations.transpose(1, 2)
    quats = matrix_to_quaternion(turns)
    quats = torch.where(quats[:, :1] < 0, -quats, quats) * rest.areas[:, None]
    return _unit_or(_summed(quats, faces, len(vertices)), (1.0, 0.0, 0.0, 0.0))


def _summed(values: Float[Tensor, "F C"], faces: Int[Tensor, "F 3"], count: int) -> Float[Tensor, "V C"]:
    """Sum of the values of the triangles around each vertex, added in the order of the triangles."""
    return values.new_zeros(count, values.shape[1]).index_add(0, faces.flatten(), values.repeat_interleave(3, 0))


def _unit_or(values: Tensor, fallback: tuple[float, ...]) -> Tensor:
    """Normalized rows, and `fallback` for those without length."""
    zero = (values.detach().norm(dim=-1, keepdim=True) <= LEAST_LENGTH).expand_as(values)
    return normalize(torch.where(zero, constant_like(fallback, values), values), dim=-1, eps=LEAST_LENGTH)
