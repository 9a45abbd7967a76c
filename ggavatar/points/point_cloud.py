"""The canonical points and their schedule: first few and large, then doubled and smaller, the hidden ones dropped.

Survivors keep Adam's moments and newborn points start without; the authors' code begins a new Adam for everything.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool
from torch import Tensor, nn
from torch.nn.functional import normalize

from ggavatar.optim.parameters import Column, Rows

SHRINKING = 0.75
"""Factor of the radius for twice as many points (PointAvatar)."""


@dataclass(frozen=True)
class CloudSchedule:
    """When points are added and dropped (PointAvatar)."""

    epoch: int
    """Steps of an epoch."""
    upsampling: int
    """Epochs between two doublings."""
    pruning: int
    """Steps between two prunings."""
    most: int
    """No doubling may lead to more points than this."""
    least_radius: float
    """No pruning once discs are smaller than this, normalized device coordinates."""


class PointCloud(nn.Module):
    """Points with the radius of their discs, and which of them have shown since the last pruning.

    Args:
        count: Points at first, on a sphere about the origin.
        sphere: Its radius, in the unit of the points.
        radius_factor: Radius of the discs of 100 points, normalized device coordinates.
        rate: Learning rate of the positions.
        generator: Draws the first points.
        start: The first points themselves, [count, 3], instead of a sphere.
    """

    radius: Tensor

    def __init__(
        self,
        count: int,
        sphere: float,
        radius_factor: float,
        rate: float,
        generator: torch.Generator,
        start: Tensor | None = None,
    ) -> None:
        super().__init__()
        if start is None:
            start = sphere * normalize(2 * torch.rand(count, 3, generator=generator) - 1, dim=1)
        shown = torch.zeros(count, dtype=torch.bool)
        self.rows = Rows({"points": Column(start, rate)}, {"shown": shown}, _adam)
        first = radius_factor * SHRINKING ** torch.log2(torch.tensor(count / 100, dtype=torch.float64))
        self.register_buffer("radius", first)

    @property
    def points(self) -> Tensor:
        """Positions, in the unit of the points."""
        return self.rows["points"]

    @torch.no_grad()
    def advance(self, step: int, shown: Bool[Tensor, " N"], plan: CloudSchedule, generator: torch.Generator) -> None:
        """Note which discs showed in `step`, then prune and double if it is time."""
        marks = self.rows["shown"]
        marks |= shown
        if step % plan.pruning == 0:
            if float(self.radius) >= plan.least_radius and bool(marks.any()):
                self.rows.take(torch.nonzero(marks)[:, 0])
            self.rows["shown"].zero_()
        if step % (plan.epoch * plan.upsampling) == 0 and 2 * len(self.rows) <= plan.most:
            self.upsample(generator)

    @torch.no_grad()
    def upsample(self, generator: torch.Generator) -> None:
        """A second point near every point, by up to half a disc's radius along each axis, and smaller discs."""
        points = self.points
        noise = torch.rand(points.shape, generator=generator).to(points) - 0.5
        fresh = {"points": points + noise * float(self.radius), "shown": torch.zeros_like(self.rows["shown"])}
        self.rows.append(fresh)
        self.radius.mul_(SHRINKING)


def _adam(groups: list[dict]) -> torch.optim.Optimizer:
    return torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-8, fused=True)
