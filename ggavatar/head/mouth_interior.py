"""The volume of teeth and tongue for meshes without them: a cylinder behind the lips (Gaussian Blendshapes)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.head.model import HeadModel

LIP_REGIONS = ("lips", "mouth")
"""Regions that locate the mouth, preferred first."""
TEETH_REGIONS = ("teeth", "upper_teeth")
"""Regions that only meshes with teeth have."""


@dataclass(frozen=True)
class MouthCylinder:
    """An upright cylinder in head space.

    Attributes:
        center: Center, m.
        radius: Radius, m.
        half_height: Half of the height, m.
    """

    center: Float[Tensor, "3"]
    radius: float
    half_height: float

    @staticmethod
    def of(head: HeadModel) -> MouthCylinder | None:
        """The cylinder of a head: its diameter is the width of the neutral lips, its front touches them.

        The half height is 0.8 of the radius. On FLAME this is close to the cylinder in the authors' code (radius 27 mm,
        half height 22 mm). None if the head has no region of the lips, or has teeth.
        """
        region = next((head.regions[name] for name in LIP_REGIONS if name in head.regions), None)
        if region is None or any(name in head.regions for name in TEETH_REGIONS):
            return None
        lips = head.neutral()[region]
        radius = float(lips[:, 0].max() - lips[:, 0].min()) / 2
        middle = (lips.amin(0) + lips.amax(0)) / 2
        center = torch.stack((middle[0], middle[1], lips[:, 2].max() - radius))
        return MouthCylinder(center, radius, 0.8 * radius)

    def points(self, count: int, generator: torch.Generator) -> Float[Tensor, "N 3"]:
        """Random points, uniform in the cylinder, in head space, m."""
        draws = torch.rand(count, 3, generator=generator).to(self.center)
        radius, angle = self.radius * draws[:, 0].sqrt(), 2 * math.pi * draws[:, 1]
        height = self.half_height * (2 * draws[:, 2] - 1)
        return self.center + torch.stack((radius * angle.cos(), height, radius * angle.sin()), dim=1)

    def outside(self, points: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """Squared distance of points from the cylinder, m²; 0 inside."""
        apart = points - self.center
        square = apart[:, 0].square() + apart[:, 2].square()
        beyond = square > self.radius**2
        across = (square.where(beyond, 1.0).sqrt() - self.radius) * beyond
        above = (apart[:, 1].abs() - self.half_height).clamp_min(0)
        return across.square() + above.square()
