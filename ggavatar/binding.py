"""Gaussians bound to triangles: from the local space of a face to the world (GGAvatar Eq. 6–8)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

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
    return bind_in_torch(local_means, local_quats, local_log_scales, face_index, frames)


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
