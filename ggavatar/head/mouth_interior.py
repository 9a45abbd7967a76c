"""Where teeth and tongue can be, for heads whose mesh has none: a cylinder behind the lips (Gaussian Blendshapes)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.head.model import HeadModel

LIPS = ("lips", "mouth")
"""Regions that say where the mouth is, best first."""
TEETH = ("teeth", "upper_teeth")
"""Regions that say that the mesh has teeth of its own."""


@dataclass(frozen=True)
class MouthCylinder:
    """An upright cylinder in head space.

    Attributes:
        center: Of the cylinder, m.
        radius: m.
        half_height: m.
    """

    center: Float[Tensor, "3"]
    radius: float
    half_height: float

    @staticmethod
    def of(head: HeadModel) -> MouthCylinder | None:
        """Half as wide as the neutral lips, 0.8 of that high to either side, its front at the lips.

        On FLAME this is about the cylinder of the authors' code (radius 27 mm, half height 22 mm). None if the head
        does not say where its lips are, or has teeth.
        """
        region = next((head.regions[name] for name in LIPS if name in head.regions), None)
        if region is None or any(name in head.regions for name in TEETH):
            return None
        lips = head.neutral()[region]
        radius = float(lips[:, 0].max() - lips[:, 0].min()) / 2
        middle = (lips.amin(0) + lips.amax(0)) / 2
        center = torch.stack((middle[0], middle[1], lips[:, 2].max() - radius))
        return MouthCylinder(center, radius, 0.8 * radius)

    def points(self, count: int, generator: torch.Generator) -> Float[Tensor, "N 3"]:
        """Points evenly in the cylinder, head space, m."""
        draws = torch.rand(count, 3, generator=generator).to(self.center)
        radius, angle = self.radius * draws[:, 0].sqrt(), 2 * math.pi * draws[:, 1]
        height = self.half_height * (2 * draws[:, 2] - 1)
        return self.center + torch.stack((radius * angle.cos(), height, radius * angle.sin()), dim=1)

    def outside(self, points: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """Squared distance of points from the cylinder, m²; 0 inside."""
        apart = points - self.center
        square = apart[:, 0].square() + apart[:, 2].square()
        beyond = square > self.radius**2
        across = (square.where(beyond, square.new_tensor(1.0)).sqrt() - self.radius) * beyond
        above = (apart[:, 1].abs() - self.half_height).clamp_min(0)
        return across.square() + above.square()
