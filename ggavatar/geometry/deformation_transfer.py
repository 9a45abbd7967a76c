"""Transfer of mesh blendshapes to what is bound to the mesh's triangles (Sumner and Popović 2004).

A blendshape deforms every triangle by an affine map. The map moves any point bound to the triangle and the map's
rotation turns it; both are linear in the coefficient once written as differences from the neutral triangle.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.geometry.transforms import matrix_to_quaternion
from ggavatar.jit.constants import constant_like

POLAR_ITERATIONS = 8
"""Newton steps toward the nearest rotation; each squares the error."""


class FaceDeformations(NamedTuple):
    """How one unit of each of K blendshapes deforms each of F triangles, as differences from the identity.

    Attributes:
        table: For every face the 9 entries of the linear map (row-major), the 3 of its translation (m) and the 4 of its
            rotation's quaternion, each minus the identity's.
        displacement: Distance by which the centroid moves, m.
    """

    table: Float[Tensor, "F 16 K"]
    displacement: Float[Tensor, "F K"]

    def at(self, coefficients: Float[Tensor, " K"]) -> tuple[Tensor, Tensor, Tensor]:
        """The blended map I + Σ c_k linear_k [F, 3, 3], its offset [F, 3] and its quaternion, not normalized [F, 4]."""
        identity = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        blended = (self.table.flatten(0, 1) @ coefficients).view(-1, 16) + constant_like(identity, self.table)
        return blended[:, :9].unflatten(1, (3, 3)), blended[:, 9:12], blended[:, 12:]

    def with_static_faces(self, count: int) -> FaceDeformations:
        """The same with `count` more faces that no blendshape deforms."""
        return FaceDeformations(*(torch.cat((part, part.new_zeros(count, *part.shape[1:]))) for part in self))


def transfer_blendshapes(
    template: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], displacements: Float[Tensor, "V 3 K"]
) -> FaceDeformations:
    """Deformation of every triangle by every blendshape.

    Args:
        template: Neutral vertices, m.
        faces: Vertex indices.
        displacements: Displacement of every vertex by one unit of each blendshape, m.

    Returns:
        Deformation gradients, with the centroid moving as on the mesh. A triangle without area is only translated.

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
        invertible = usable & (torch.linalg.det(gradient) > 1e-6)
        linear = torch.where(invertible[:, None, None], gradient, identity) - identity
        offset = shape[faces].mean(1) - (linear @ center[:, :, None]).squeeze(-1)
        quat = matrix_to_quaternion(nearest_rotation(linear + identity))
        quat = quat * torch.where(quat[:, :1] < 0, -1.0, 1.0) - quat.new_tensor([1.0, 0.0, 0.0, 0.0])
        table.append(torch.cat((linear.flatten(1), offset, quat), dim=1))
    return FaceDeformations(torch.stack(table, -1), displacements[faces].mean(1).norm(dim=1))


def nearest_rotation(matrices: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3 3"]:
    """Rotations of the polar decomposition of matrices with positive determinant (Higham: R ← (R + R⁻ᵀ) / 2)."""
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
