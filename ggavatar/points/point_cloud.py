"""The canonical points and their schedule: repeatedly doubled while their discs shrink; invisible points are pruned.

Kept points keep their Adam moments and new points start with zero moments; the authors' code creates a new Adam.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor, nn
from torch.nn.functional import normalize

from ggavatar.optim.parameters import Column, Rows

SHRINKING = 0.75
"""Factor on the radius at each doubling of the points (PointAvatar)."""


@dataclass(frozen=True)
class CloudSchedule:
    """Schedule of adding and pruning points (PointAvatar)."""

    steps_per_epoch: int
    """Steps per epoch."""
    upsampling_epochs: int
    """Epochs between two doublings."""
    pruning_steps: int
    """Steps between two prunings."""
    max_points: int
    """Maximum number of points after a doubling."""
    min_radius: float
    """Radius of discs below which points are no longer pruned, normalized device coordinates."""


class PointCloud(nn.Module):
    """Points, the radius of their discs, and flags of the points that were visible since the last pruning.

    Args:
        count: Initial number of points, on a sphere about the origin.
        sphere: Radius of that sphere, in the unit of the points.
        radius_factor: Radius of the discs for 100 points, normalized device coordinates.
        rate: Learning rate of the positions.
        generator: Draws the initial points.
        start: Initial points [count, 3] to use instead of a sphere.
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

    def _apply(self, fn: Any, recurse: bool = True) -> Any:
        """Move everything but the radius, as `to` does: the host reads it in every step."""
        radius = self.radius
        super()._apply(fn, recurse)
        self.radius = radius
        return self

    @property
    def points(self) -> Tensor:
        """Positions, in the unit of the points."""
        return self.rows["points"]

    @torch.no_grad()
    def advance(self, step: int, shown: Bool[Tensor, " N"], plan: CloudSchedule, generator: torch.Generator) -> None:
        """Record which discs were visible in `step`, then prune and double the points when due."""
        marks = self.rows["shown"]
        marks |= shown
        if step % plan.pruning_steps == 0:
            if float(self.radius) >= plan.min_radius and bool(marks.any()):
                self.rows.take(torch.nonzero(marks)[:, 0])
            self.rows["shown"].zero_()
        if step % (plan.steps_per_epoch * plan.upsampling_epochs) == 0 and 2 * len(self.rows) <= plan.max_points:
            self.upsample(generator)

    @torch.no_grad()
    def upsample(self, generator: torch.Generator) -> None:
        """Add a point near every point, at most half a disc's radius away along each axis, and shrink the discs."""
        points = self.points
        noise = torch.rand(points.shape, generator=generator).to(points) - 0.5
        fresh = {"points": points + noise * float(self.radius), "shown": torch.zeros_like(self.rows["shown"])}
        self.rows.append(fresh)
        self.radius.mul_(SHRINKING)


def _adam(groups: list[dict[str, Any]]) -> torch.optim.Optimizer:
    return torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-8, fused=True)
