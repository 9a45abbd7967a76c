"""Skinning of canonical points from the canonical pose to another pose, with its Jacobian."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.points.deformer import PointDeformation


class BoneTransforms(NamedTuple):
    """Transforms x ↦ rotation · x + offset of all joints, in the unit of the points."""

    rotations: Float[Tensor, "J 3 3"]
    offsets: Float[Tensor, "J 3"]


class DeformedPoints(NamedTuple):
    """Posed points; `tangents[:, k]` is their derivative with respect to the k-th coordinate of the canonical point."""

    points: Float[Tensor, "N 3"]
    tangents: Float[Tensor, "N 3 3"]


def deform(
    points: Float[Tensor, "N 3"], deformation: PointDeformation, canonical: BoneTransforms, posed: BoneTransforms
) -> DeformedPoints:
    """Linear blend skinning of points from one pose to another.

    A point x maps to B (A⁻¹ (x + offset − a) + c) + b, where (A, a) is the blended canonical transform and (B, b) the
    blended posed one. The correctives c are those of the pose minus those of the canonical pose.

    References:
        PointAvatar (Zheng et al. 2023), Eq. 2–4, and its derivative by the product rule.
    """
    joints = len(canonical.offsets)
    parts = torch.cat([part.reshape(joints, -1) for part in (*canonical, *posed)], dim=1)
    blended, slopes = deformation.weights @ parts, deformation.weight_tangents @ parts
    back, start, to, end = _split(blended)
    back_slope, start_slope, to_slope, end_slope = _split(slopes)
    inverse = inverse_3x3(back)
    rest = _times(inverse, points + deformation.offsets - start)
    shaped = rest + deformation.correctives
    identity = torch.eye(3, dtype=points.dtype, device=points.device)
    moved = deformation.offset_tangents + identity - start_slope - _times(back_slope, rest[:, None])
    shaped_slope = _times(inverse[:, None], moved) + deformation.corrective_tangents
    tangents = _times(to_slope, shaped[:, None]) + _times(to[:, None], shaped_slope) + end_slope
    return DeformedPoints(_times(to, shaped) + end, tangents)


def _split(parts: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Two rotations and two offsets from 24 columns."""
    first, start, second, end = parts.split((9, 3, 9, 3), dim=-1)
    return first.unflatten(-1, (3, 3)), start, second.unflatten(-1, (3, 3)), end


def _times(matrices: Tensor, vectors: Tensor) -> Tensor:
    """Matrix times vector, the last axes of each."""
    return (matrices * vectors[..., None, :]).sum(-1)


def inverse_3x3(matrices: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3 3"]:
    """Inverse matrices from cross products of the rows, faster than torch.linalg.inv on small matrices."""
    a, b, c = matrices.unbind(-2)
    columns = torch.stack((torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)), dim=-1)
    return columns / (a * columns[..., 0]).sum(-1)[:, None, None]


def deformed_normals(tangents: Float[Tensor, "N 3 3"], normals: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Unit normals after a deformation: n J⁻¹, from cross products of the Jacobian's columns.

    Args:
        tangents: The transposed Jacobian Jᵀ: row k is the derivative with respect to the k-th canonical coordinate.
        normals: Canonical normals, of any length.
    """
    first, second, third = tangents.unbind(1)
    across = torch.linalg.cross(second, third)
    turned = normals[:, :1] * across
    turned = turned + normals[:, 1:2] * torch.linalg.cross(third, first)
    turned = turned + normals[:, 2:] * torch.linalg.cross(first, second)
    determinant = (first * across).sum(-1, keepdim=True)
    return torch.nn.functional.normalize(turned * determinant.sign(), dim=-1)
