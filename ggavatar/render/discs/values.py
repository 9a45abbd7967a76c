"""Discs: points drawn as small round patches of a fixed size on the image, and what drawing them returns."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.render.constants import NEAR

NEAREST = 10
"""Discs that may show in one pixel, the nearest ones (PointAvatar)."""

SHOWN_WEIGHT = 0.5
"""A disc shows if it is the first one in a pixel or weighs more than this in one (PointAvatar)."""


@dataclass(frozen=True)
class Discs(Gaussians):
    """Points that cover a disc of the image whatever their distance: alpha = 1 − d²/r².

    `means` and RGB `colors` are drawn. The other fields of a Gaussian say what the disc resembles, for whoever counts,
    exports or draws Gaussians instead.

    Attributes:
        radius: Of every disc, half the shorter side of the image (normalized device coordinates).
    """

    radius: float = 0.0


@dataclass(frozen=True)
class DiscRendering(Rendering):
    """A picture of discs.

    Attributes:
        shown: Which discs were the first one in a pixel, or weighed more than one half in one.
    """

    shown: Bool[Tensor, " N"]


def similar_scale(radius: float, distance: float) -> float:
    """Standard deviation of a Gaussian with the second moment of a disc's alpha: radius · distance / √6.

    Args:
        radius: Of the disc, normalized device coordinates.
        distance: Meters per unit of these coordinates where the disc is.
    """
    return radius * distance / 6**0.5


def radius_in_pixels(radius: float, camera: Camera) -> float:
    """Radius in px of discs of a radius in normalized device coordinates."""
    return radius * min(camera.width, camera.height) / 2


def project_discs(
    means: Float[Tensor, "N 3"], radius: float, camera: Camera
) -> tuple[Float[Tensor, "N 2"], Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Centers in px, camera z in m, and radii in px, which are 0 for discs behind the camera or beside the image.

    Sums of three terms are written out, so that they come in one order whatever the threads do.
    """
    x, y, z = means.unbind(-1)
    rows = camera.world_to_camera.to(means).unbind(0)
    right, down, depths = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in rows[:3])
    safe = torch.where(depths > NEAR, depths, torch.ones_like(depths))
    k = camera.intrinsics.to(means)
    means2d = torch.stack((k[0, 0] * right / safe + k[0, 2], k[1, 1] * down / safe + k[1, 2]), dim=-1)
    reach = radius_in_pixels(radius, camera)
    place, size = means2d.detach(), means2d.new_tensor([camera.width, camera.height])
    inside = ((place + reach > 0) & (place - reach < size)).all(-1) & (depths.detach() > NEAR)
    return means2d, depths, torch.where(inside, reach, 0.0).to(means.dtype)
