"""Initialization from the head model: points on its surface, and networks fitted to its distance and deformation.

Not in PointAvatar, which learns both from images within hours; a training of minutes is too short for that.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import mse_loss, normalize

from ggavatar.core import Drive
from ggavatar.geometry.surface_sampling import sample_surface
from ggavatar.head.model import HeadModel
from ggavatar.points.canonical import CanonicalNetwork
from ggavatar.points.deformer import PointDeformer
from ggavatar.points.head_targets import HeadTargets

ROWS = 512
"""Points per fitting step."""
RATE = 2e-3
"""Initial learning rate of the fitting; it falls linearly to 0."""
NEIGHBOURS = 0.25
"""Maximum distance per axis of the random neighbors for the eikonal loss, quarter meters."""


class HeadSurface(NamedTuple):
    """Points on the head model in its canonical pose, quarter meters, with the unit normals of their triangles."""

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]

    @staticmethod
    def of(head: HeadModel, canonical: Drive, unit: float, count: int, generator: torch.Generator) -> HeadSurface:
        """`count` points, evenly distributed by area; `unit` is the number of units of length per meter."""
        vertices = unit * head.vertices(canonical)
        points, face, _ = sample_surface(vertices, head.faces, count, generator)
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
    """Fit the networks to the head model's signed distance, blendshapes and skinning weights."""
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
    """Loss: distance 0 and the mesh's normal on its surface, a gradient of length 1 around it."""
    around = points + 2 * NEIGHBOURS * (torch.rand(points.shape, generator=generator).to(points) - 0.5)
    on, off = network(points), network(around)
    lengths = off.gradient.norm(dim=1)
    return on.distance.square().mean() + 0.1 * (
        mse_loss(on.gradient, normals) + mse_loss(lengths, torch.ones_like(lengths))
    )
