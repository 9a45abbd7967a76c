"""From Gaussians in world space to GaussianAvatars' layout, in which each is in the local frame of a triangle."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.core import Gaussians
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, to_stored
from ggavatar.geometry.transforms import matrix_to_quaternion, quaternion_multiply
from ggavatar.geometry.triangles import TriangleFrames
from ggavatar.optim.parameters import Rows

MIN_TRIANGLE_SIZE = 1e-9
"""Sizes of triangles are clipped to at least this, m."""

_CHUNK = 4096


def unbind(gaussians: Gaussians, faces: Int[Tensor, " N"], frames: TriangleFrames) -> StoredGaussians:
    """World-space Gaussians in the local frames of their triangles: inverts `ggavatar.gaussians.binding.bind`.

    μ0 = Rᵀ(μ − M) / S, r0 = q(R)* ⊗ r and s0 = s / S (GaussianAvatars, Sec. 3.2).

    Args:
        gaussians: In world space.
        faces: The triangle of each.
        frames: Frames of all triangles of the mesh, animated by the same drive.
    """
    sizes = frames.scales[faces, None].clamp_min(MIN_TRIANGLE_SIZE)
    rotations = frames.rotations[faces]
    local = (rotations.transpose(1, 2) @ (gaussians.means - frames.centers[faces])[:, :, None]).squeeze(-1)
    conjugates = matrix_to_quaternion(frames.rotations)[faces] * local.new_tensor([1.0, -1.0, -1.0, -1.0])
    bound = dataclasses.replace(
        gaussians,
        means=local / sizes,
        quats=quaternion_multiply(conjugates, gaussians.quats),
        scales=gaussians.scales / sizes,
    )
    return dataclasses.replace(to_stored(bound), faces=faces.cpu().numpy())


def binding_of(avatar: torch.nn.Module, count: int, faces: int) -> Int[Tensor, " N"] | None:
    """The triangle of every Gaussian, for methods that store it in the column `face` of their rows; else None.

    Args:
        avatar: Of any method.
        count: Number of its Gaussians.
        faces: Number of the head's triangles.
    """
    rows = getattr(avatar, "rows", None)
    if not isinstance(rows, Rows) or "face" not in rows.columns() or len(rows) != count:
        return None
    found = rows["face"]
    return found if bool((found < faces).all()) else None


def nearest_faces(means: Float[Tensor, "N 3"], frames: TriangleFrames) -> Int[Tensor, " N"]:
    """Index of the triangle whose center is nearest to each point."""
    return torch.cat([torch.cdist(part, frames.centers).argmin(1) for part in means.split(_CHUNK)])
