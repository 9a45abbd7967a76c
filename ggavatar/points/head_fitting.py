"""A start at the head model: points on its surface, and networks that know its distance and its motion. Ours.

PointAvatar learns all this beside the pictures, within hours; a training of minutes has no time for it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import mse_loss, normalize

from ggavatar.core import Drive
from ggavatar.geometry.surface_sampling import spread_points
from ggavatar.head.model import HeadModel
from ggavatar.points.canonical import CanonicalNetwork
from ggavatar.points.deformer import PointDeformer
from ggavatar.points.head_targets import HeadTargets

ROWS = 512
"""Points of a fitting step."""
RATE = 2e-3
"""Learning rate of the fitting, which falls to nothing."""
NEIGHBOURS = 0.25
"""Reach of the neighbors at which the gradient's length is looked at, quarter meters."""


class HeadSurface(NamedTuple):
    """Points on the head model in its canonical pose, quarter meters, with the unit normals of their triangles."""

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]

    @staticmethod
    def of(head: HeadModel, canonical: Drive, unit: float, count: int, generator: torch.Generator) -> HeadSurface:
        """`count` points, spread by area; `unit` of length of the points per meter."""
        vertices = unit * head.vertices(canonical)
        points, face, _ = spread_points(vertices, head.faces, count, generator)
        corners = vertices[head.faces[face]]
        across = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return HeadSurface(points, normalize(across, dim=-1))


def fit_to_head(
    networks: tuple[CanonicalNetwork, PointDeformer],
    surface: HeadSurface,
    targets: HeadTargets,
    steps: int,
    generator: torch.Generator,
) -> None:
    """Let the networks learn the head model's signed distance, blendshapes and skinning weights."""
    canonical, deformer = networks
    parameters = [*canonical.parameters(), *deformer.parameters()]
    optimizer = torch.optim.Adam(parameters, lr=RATE, fused=True)
    falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, steps)
    for _ in range(steps):
        some = torch.randint(len(surface.points), (ROWS,), generator=generator).to(surface.points.device)
        points, normals = surface.points[some], surface.normals[some]
        with torch.enable_grad():
            losses = targets.losses(deformer.bases(points), points)
            loss = torch.stack(list(losses.values())).sum() + _distance_loss(canonical, points, normals, generator)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
        optimizer.step()
        falling.step()
    optimizer.zero_grad(set_to_none=True)


def _distance_loss(network: CanonicalNetwork, points: Tensor, normals: Tensor, generator: torch.Generator) -> Tensor:
    """Distance 0 and the mesh's normal on its surface, a gradient of length 1 around it."""
    around = points + 2 * NEIGHBOURS * (torch.rand(points.shape, generator=generator).to(points) - 0.5)
    on, off = network(points), network(around)
    lengths = off.gradient.norm(dim=1)
    return on.distance.square().mean() + 0.1 * (
        mse_loss(on.gradient, normals) + mse_loss(lengths, torch.ones_like(lengths))
    )
