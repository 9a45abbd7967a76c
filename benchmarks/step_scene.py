"""A training step of the paper's method on the procedural head: bound Gaussians, adjuster, losses, Adam."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from ggavatar.core import Camera, Drive, Gaussians, Rendering
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.offsets import Offsets, refine
from ggavatar.geometry.transforms import look_at
from ggavatar.geometry.triangles import TriangleFrames, triangle_frames
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head
from ggavatar.losses.dssim import DssimTarget, image_terms
from ggavatar.losses.terms import log_scale_regularizer, position_regularizer
from ggavatar.networks.fields import Box, HashTriplane, HashTriplaneConfig
from ggavatar.networks.morph_adjuster import AdjusterConfig, BasisAdjuster
from ggavatar.render.cpu import rasterizer

DISTANCE = 1.0
"""Distance between head and camera, m."""


class StepScene:
    """The state of a training step: head, Gaussians, adjuster, camera, target and optimizers.

    Args:
        count: Number of Gaussians, distributed uniformly over the triangles.
        size: Width and height of the image, px.
    """

    def __init__(self, count: int, size: int) -> None:
        generator = torch.Generator().manual_seed(0)
        self.count, self.size = count, size
        self.head: HeadModel = procedural_head()
        self.neutral = triangle_frames(self.head.neutral(), self.head.faces)
        self.face = torch.randint(0, len(self.head.faces), (count,), generator=generator)
        self.rows = nn.ParameterDict(_first_rows(count, len(self.head.faces), generator))
        self.camera, self.background = _camera(self.head, size), torch.ones(3)
        self.target = torch.rand(size, size, 3, generator=generator)
        self.kept_target = DssimTarget.of(self.target)
        field = HashTriplane(HashTriplaneConfig(), Box.around(self.head.neutral()), generator)
        self.condition = torch.randn(120, generator=generator)
        self.adjuster = BasisAdjuster(field, len(self.condition), AdjusterConfig(), generator)
        nn.init.normal_(self.adjuster.last_weight, std=0.02, generator=generator)
        expression = 0.3 * torch.randn(self.head.expression_basis.shape[2], generator=generator)
        self.drive: Drive = dataclasses.replace(self.head.neutral_drive(), expression=expression)
        self.optimizers = [_adam(self.rows), _adam(self.adjuster)]

    def positions(self) -> Tensor:
        """Neutral positions, at which the field is queried."""
        with torch.no_grad():
            return self.placed(self.neutral)[0]

    def placed(self, frames: TriangleFrames) -> tuple[Tensor, Tensor, Tensor]:
        """The Gaussians on given triangle frames."""
        return bind(self.rows["means"], self.rows["quats"], self.rows["log_scales"], self.face, frames)

    def posed_frames(self) -> TriangleFrames:
        """The triangle frames of the head with an expression."""
        with torch.no_grad():
            return triangle_frames(self.head.vertices(self.drive), self.head.faces)

    def offsets(self) -> Offsets:
        """The adjuster's offsets."""
        return self.adjuster(self.positions(), self.condition)

    def render(self, adjusted: bool) -> Rendering:
        """The rendering in one phase of the schedule."""
        means, quats, scales = self.placed(self.posed_frames() if adjusted else self.neutral)
        if adjusted:
            means, quats, scales = refine(means, quats, scales, self.offsets())
        opacities = self.rows["opacity_logits"].sigmoid()
        gaussians = Gaussians(means, quats, scales, opacities, self.rows["sh"], 3)
        return rasterizer.rasterize(gaussians, self.camera, self.background)

    def objective(self, rendering: Rendering) -> Tensor:
        """The paper's objective without the perceptual term."""
        visible = rendering.radii > 0
        color = sum(image_terms(rendering.image, self.kept_target, 0.2))
        position = position_regularizer(self.rows["means"], visible)
        return color + 0.01 * position + log_scale_regularizer(self.rows["log_scales"], visible)

    def step(self, adjusted: bool) -> None:
        """Forward, backward and Adam."""
        self.objective(self.render(adjusted)).backward()
        for optimizer in self.optimizers if adjusted else self.optimizers[:1]:
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)


def _first_rows(count: int, faces: int, generator: torch.Generator) -> dict[str, nn.Parameter]:
    """Flat Gaussians that cover their triangles; opacities are the sigmoid of N(0.6, 1.6), harmonics of degree 3."""

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    flat = torch.tensor([1.0, 0.25, 1.0])
    spread = 0.62 * (faces / count) ** 0.5
    values = {
        "means": 0.4 * normal(count, 3) * flat,
        "quats": torch.tensor([1.0, 0.0, 0.0, 0.0]) + 0.1 * normal(count, 4),
        "log_scales": (spread * flat).log() + 0.3 * normal(count, 3),
        "opacity_logits": 0.6 + 1.6 * normal(count),
        "sh": 0.1 * normal(count, 16, 3),
    }
    return {name: nn.Parameter(value) for name, value in values.items()}


def _camera(head: HeadModel, size: int) -> Camera:
    low, high = head.neutral().amin(0), head.neutral().amax(0)
    center = (low + high) / 2
    focal = 0.9 * size * DISTANCE / float((high - low).max())
    intrinsics = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    eye = center + torch.tensor([0.0, 0.0, DISTANCE])
    return Camera(intrinsics, look_at(eye, center, torch.tensor([0.0, 1.0, 0.0])), size, size)


def _adam(module: nn.Module) -> torch.optim.Optimizer:
    """Adam with a rate so small that hundreds of steps leave the scene practically unchanged."""
    return torch.optim.Adam(module.parameters(), lr=1e-7, eps=1e-15, fused=True)
