"""EWA projection of 3D Gaussians to the image, in plain torch (Zwicker et al. 2001; Kerbl et al. 2023, Eq. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ggavatar.core import Camera, Gaussians
from ggavatar.render.constants import CLAMP_MARGIN, LOW_PASS, MIN_ALPHA, MIN_NORM, NEAR


@dataclass(frozen=True)
class Projected:
    """Gaussians projected to the image plane.

    Attributes:
        means2d: Centers, px.
        depths: Camera z of the centers, m.
        covariances: Entries xx, xy, yy after the low-pass filter, px².
        conics: Entries xx, xy, yy of the inverse covariances, 1/px².
        extents: Half width and half height of the box in which alpha ≥ 1/255, px; 0 where there is none.
    """

    means2d: Float[Tensor, "N 2"]
    depths: Float[Tensor, " N"]
    covariances: Float[Tensor, "N 3"]
    conics: Float[Tensor, "N 3"]
    extents: Float[Tensor, "N 2"]


def rotation_matrices(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 3 3"]:
    """Rotation matrices of quaternions wxyz of any length; the zero quaternion is the identity."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True).clamp_min(MIN_NORM)).unbind(-1)
    return torch.stack(
        (
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ),
        dim=-1,
    ).unflatten(-1, (3, 3))  # fmt: skip


def camera_center(world_to_camera: Float[Tensor, "4 4"]) -> Float[Tensor, " 3"]:
    """Position of a camera in the world, m, given its rigid transform."""
    return -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]


def jacobian(points: Float[Tensor, "N 3"], camera: Camera) -> Float[Tensor, "N 2 3"]:
    """Derivative of pixel positions with respect to camera-space positions, at points clamped to the widened view.

    The view is widened as in gsplat: at every image edge by 0.3 of half the image, wherever the principal point is.
    """
    x, y, z = points.unbind(-1)
    focal_x, focal_y = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    ratio_x = _clamp_ratio(x / z, camera.width, focal_x, camera.intrinsics[0, 2])
    ratio_y = _clamp_ratio(y / z, camera.height, focal_y, camera.intrinsics[1, 2])
    zero = torch.zeros_like(z)
    rows = (focal_x / z, zero, -focal_x * ratio_x / z, zero, focal_y / z, -focal_y * ratio_y / z)
    return torch.stack(rows, dim=-1).unflatten(-1, (2, 3))


def _clamp_ratio(ratio: Tensor, size: int, focal: Tensor, principal: Tensor) -> Tensor:
    margin = CLAMP_MARGIN * 0.5 * size / focal
    return torch.minimum(torch.maximum(ratio, -principal / focal - margin), (size - principal) / focal + margin)


def project(gaussians: Gaussians, camera: Camera) -> Projected:
    """Project every Gaussian; rows at or behind the camera plane are meaningless.

    The covariance is M Mᵀ with M = J W R S, and its determinant is computed as the sum of the squared minors of M,
    without the cancellation that makes long thin Gaussians vanish in float32.
    """
    points = gaussians.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    image = points @ camera.intrinsics.T
    means2d = image[:, :2] / image[:, 2:]
    to_image = jacobian(points, camera) @ camera.world_to_camera[:3, :3]
    factor = to_image @ rotation_matrices(gaussians.quats) * gaussians.scales[:, None, :]
    row_0, row_1 = factor.unbind(1)
    square_0, square_1 = (row_0 * row_0).sum(-1), (row_1 * row_1).sum(-1)
    xx, xy, yy = square_0 + LOW_PASS, (row_0 * row_1).sum(-1), square_1 + LOW_PASS
    minors = torch.linalg.cross(row_0, row_1)
    determinant = (minors * minors).sum(-1) + LOW_PASS * (square_0 + square_1) + LOW_PASS**2
    covariances = torch.stack((xx, xy, yy), dim=-1)
    conics = torch.stack((yy, -xy, xx), dim=-1) / determinant[:, None]
    reach = 2 * torch.log(gaussians.opacities.detach() / MIN_ALPHA).clamp_min(0)
    extents = torch.sqrt(reach[:, None] * torch.stack((xx, yy), dim=-1).detach())
    return Projected(means2d, points[:, 2], covariances, conics, extents)


def visible(projected: Projected, opacities: Float[Tensor, " N"], camera: Camera) -> Bool[Tensor, " N"]:
    """Which Gaussians are in front of the camera with a box of alpha ≥ 1/255 that meets the image.

    Gaussians whose projection overflows are invisible.
    """
    low, high = projected.means2d - projected.extents, projected.means2d + projected.extents
    size = low.new_tensor([camera.width, camera.height])
    in_image = ((high > 0) & (low < size)).all(-1)
    finite = (
        torch.isfinite(projected.conics).all(-1)
        & torch.isfinite(projected.extents).all(-1)
        & (projected.conics[:, 0] > 0)
    )
    return in_image & finite & (projected.depths > NEAR) & (opacities >= MIN_ALPHA)
