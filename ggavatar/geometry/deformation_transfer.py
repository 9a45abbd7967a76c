"""Mesh blendshapes carried over to what is bound to the triangles of the mesh (Sumner and Popović 2004).

A blendshape changes every triangle by an affine map. The map moves any point bound to that triangle, its rotation turns
it, and both are linear in the coefficient once they are written as differences from the neutral triangle.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.geometry.transforms import matrix_to_quaternion

POLAR_ITERATIONS = 8
"""Newton steps toward the nearest rotation; each squares the error."""


class FaceChanges(NamedTuple):
    """What one unit of each of K blendshapes does to each of F triangles, as differences from doing nothing.

    Attributes:
        table: For every face 9 entries of the affine map, row-major, 3 of its translation (m) and 4 of its rotation's
            quaternion, each minus what the identity has.
        displacement: Distance the centroid is moved, m.
    """

    table: Float[Tensor, "F 16 K"]
    displacement: Float[Tensor, "F K"]

    def at(self, coefficients: Float[Tensor, " K"]) -> tuple[Tensor, Tensor, Tensor]:
        """The blended map I + Σ c_k linear_k [F, 3, 3], offset [F, 3] and quaternion, not of unit length [F, 4]."""
        identity = self.table.new_tensor([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0])
        blended = (self.table.flatten(0, 1) @ coefficients).view(-1, 16) + identity
        return blended[:, :9].unflatten(1, (3, 3)), blended[:, 9:12], blended[:, 12:]

    def with_still(self, count: int) -> FaceChanges:
        """The same with more faces that no blendshape changes."""
        return FaceChanges(*(torch.cat((part, part.new_zeros(count, *part.shape[1:]))) for part in self))


def transferred(
    template: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], displacements: Float[Tensor, "V 3 K"]
) -> FaceChanges:
    """Differences of every triangle under every blendshape.

    Args:
        template: Neutral vertices, m.
        faces: Vertex indices.
        displacements: Of the vertices by one unit of each blendshape, m.

    Returns:
        Deformation gradients, with the centroid moving as the mesh does. A triangle without area is only translated.

    References:
        Sumner and Popović 2004, Sec. 3: Q = V' V⁻¹, V = (edge, edge, normal / √|normal|).
    """
    source = _axes(template[faces])
    usable = torch.linalg.det(source).abs() > 1e-18
    identity = torch.eye(3, dtype=template.dtype, device=template.device)
    inverse = torch.linalg.inv(torch.where(usable[:, None, None], source, identity))
    center = template[faces].mean(1)
    table = []
    for shape in displacements.unbind(-1):
        gradient = _axes((template + shape)[faces]) @ inverse
        kept = usable & (torch.linalg.det(gradient) > 1e-6)
        linear = torch.where(kept[:, None, None], gradient, identity) - identity
        offset = shape[faces].mean(1) - (linear @ center[:, :, None]).squeeze(-1)
        turn = matrix_to_quaternion(nearest_rotation(linear + identity))
        turn = turn * torch.where(turn[:, :1] < 0, -1.0, 1.0) - turn.new_tensor([1.0, 0.0, 0.0, 0.0])
        table.append(torch.cat((linear.flatten(1), offset, turn), dim=1))
    return FaceChanges(torch.stack(table, -1), displacements[faces].mean(1).norm(dim=1))


def nearest_rotation(matrices: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3 3"]:
    """The rotations of the polar decomposition of matrices of positive determinant (Higham: R ← (R + R⁻ᵀ) / 2)."""
    for _ in range(POLAR_ITERATIONS):
        x, y, z = matrices.unbind(1)
        cofactors = torch.stack((torch.linalg.cross(y, z), torch.linalg.cross(z, x), torch.linalg.cross(x, y)), dim=1)
        determinant = (x * cofactors[:, 0]).sum(-1)[:, None, None]
        matrices = (matrices + cofactors / determinant) / 2
    return matrices


def _axes(corners: Float[Tensor, "F 3 3"]) -> Float[Tensor, "F 3 3"]:
    """Two edges and the scaled normal of every triangle, as columns."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = torch.linalg.cross(first, second)
    return torch.stack((first, second, normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-20).sqrt()), dim=-1)
