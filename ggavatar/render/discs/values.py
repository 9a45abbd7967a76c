"""Discs, points that are rendered as round patches of a fixed size on the image, and their renderings."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.jit.constants import constant_like
from ggavatar.render.constants import NEAR

NEAREST = 10
"""Number of discs that are blended in a pixel: the nearest ones (PointAvatar)."""

SHOWN_WEIGHT = 0.5
"""A disc shows if it is the first one in some pixel or its weight there exceeds this (PointAvatar)."""


@dataclass(frozen=True)
class Discs(Gaussians):
    """Points that cover a disc of the image whatever their distance: alpha = 1 − d²/r².

    Only `means` and RGB `colors` are rendered. The other fields describe a similar Gaussian, for code that counts,
    exports or renders Gaussians instead.

    Attributes:
        radius: Radius of every disc in normalized device coordinates, whose unit is half the image's shorter side.
    """

    radius: float = 0.0


@dataclass(frozen=True)
class DiscRendering(Rendering):
    """A rendering of discs.

    Attributes:
        shown: Which discs are the first one in some pixel, or have a weight above one half in one.
    """

    shown: Bool[Tensor, " N"]


def similar_scale(radius: float, distance: float) -> float:
    """Standard deviation in m of a Gaussian with the second moment of a disc's alpha: radius · distance / √6.

    Args:
        radius: Radius of the disc, normalized device coordinates.
        distance: Meters per unit of these coordinates at the disc's depth.
    """
    return radius * distance / 6**0.5


def radius_in_pixels(radius: float, camera: Camera) -> float:
    """Radius in px, given a radius in normalized device coordinates."""
    return radius * min(camera.width, camera.height) / 2


def project_discs(
    means: Float[Tensor, "N 3"], radius: float, camera: Camera
) -> tuple[Float[Tensor, "N 2"], Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Centers in px, camera z in m, and radii in px, which are 0 for discs behind the camera or outside the image.

    Sums of three terms are written out, so that their order does not depend on the number of threads.
    """
    x, y, z = means.unbind(-1)
    rows = camera.world_to_camera.to(means).unbind(0)
    right, down, depths = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in rows[:3])
    safe = torch.where(depths > NEAR, depths, torch.ones_like(depths))
    k = camera.intrinsics.to(means)
    means2d = torch.stack((k[0, 0] * right / safe + k[0, 2], k[1, 1] * down / safe + k[1, 2]), dim=-1)
    reach = radius_in_pixels(radius, camera)
    center, size = means2d.detach(), constant_like((camera.width, camera.height), means2d)
    inside = ((center + reach > 0) & (center - reach < size)).all(-1) & (depths.detach() > NEAR)
    return means2d, depths, torch.where(inside, reach, 0.0).to(means.dtype)
