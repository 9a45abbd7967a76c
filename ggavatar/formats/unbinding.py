"""Between Gaussians in the world and GaussianAvatars' layout, in which each lives in the space of a triangle."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.core import Gaussians
from ggavatar.formats.stored_gaussians import Stored, stored
from ggavatar.geometry.transforms import matrix_to_quaternion, quaternion_multiply
from ggavatar.geometry.triangles import TriangleFrames
from ggavatar.optim.parameters import Rows

SMALLEST_TRIANGLE = 1e-9
"""m; below this a triangle has no space of its own."""

_CHUNK = 4096


def unbind(gaussians: Gaussians, faces: Int[Tensor, " N"], frames: TriangleFrames) -> Stored:
    """World Gaussians in the spaces of their triangles: the inverse of `ggavatar.gaussians.binding.bind`.

    μ0 = Rᵀ(μ − M) / S, r0 = q(R)* ⊗ r and s0 = s / S (GaussianAvatars, Sec. 3.2).

    Args:
        gaussians: In the world.
        faces: The triangle of each.
        frames: Of the mesh in the same pose.
    """
    sizes = frames.scales[faces, None].clamp_min(SMALLEST_TRIANGLE)
    rotations = frames.rotations[faces]
    local = (rotations.transpose(1, 2) @ (gaussians.means - frames.centers[faces])[:, :, None]).squeeze(-1)
    backwards = matrix_to_quaternion(frames.rotations)[faces] * local.new_tensor([1.0, -1.0, -1.0, -1.0])
    bound = dataclasses.replace(
        gaussians,
        means=local / sizes,
        quats=quaternion_multiply(backwards, gaussians.quats),
        scales=gaussians.scales / sizes,
    )
    return dataclasses.replace(stored(bound), faces=faces.cpu().numpy())


def binding_of(avatar: torch.nn.Module, count: int, faces: int) -> Int[Tensor, " N"] | None:
    """The triangle of every Gaussian, for methods that keep it as the column `face` of their rows; else None."""
    rows = getattr(avatar, "rows", None)
    if not isinstance(rows, Rows) or "face" not in rows.columns() or len(rows) != count:
        return None
    found = rows["face"]
    return found if bool((found < faces).all()) else None


def nearest_faces(means: Float[Tensor, "N 3"], frames: TriangleFrames) -> Int[Tensor, " N"]:
    """The triangle whose centre is nearest to each point."""
    return torch.cat([torch.cdist(part, frames.centers).argmin(1) for part in means.split(_CHUNK)])
