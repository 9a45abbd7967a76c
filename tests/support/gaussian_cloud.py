"""A small asymmetric cloud of Gaussians with view-dependent color, and a camera above and beside it."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import normalize

from ggavatar.core import Camera, Gaussians
from ggavatar.geometry.transforms import look_at
from ggavatar.render.reference import rasterize


def cloud(count: int = 60, degree: int = 3, seed: int = 0) -> Gaussians:
    """Gaussians of 8 to 40 mm in a head-sized box; opacities, rotations and colors at random."""
    random = torch.Generator().manual_seed(seed)
    means = (torch.rand(count, 3, generator=random) - 0.5) * torch.tensor([0.2, 0.3, 0.1])
    colors = torch.rand(count, (degree + 1) ** 2, 3, generator=random) - 0.5
    colors[:, 0] *= 2.5
    colors[:, 1:] *= 0.3
    return Gaussians(
        means=means,
        quats=normalize(torch.randn(count, 4, generator=random), dim=1),
        scales=0.008 * torch.exp(1.6 * torch.rand(count, 3, generator=random)),
        opacities=0.1 + 0.85 * torch.rand(count, generator=random),
        colors=colors,
    )


def camera(side: int = 64) -> Camera:
    """From above and the side: every axis matters."""
    intrinsics = torch.tensor([[2.0 * side, 0, side / 2], [0, 2.0 * side, side / 2], [0, 0, 1]])
    view = look_at(torch.tensor([0.3, 0.25, 0.7]), torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    return Camera(intrinsics, view, side, side)


def render(gaussians: Gaussians) -> torch.Tensor:
    """Their image on white by the plain-torch rasterizer."""
    return rasterize(gaussians, camera(), torch.ones(3)).image


def psnr(left: torch.Tensor, right: torch.Tensor) -> float:
    """PSNR between two images, dB."""
    return float(-10 * np.log10(max(float(((left - right) ** 2).mean()), 1e-12)))
