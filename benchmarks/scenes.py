"""The scene of the rasterizer benchmarks: Gaussians on a head-like ellipsoid that fills half of the image."""

from __future__ import annotations

import math

import torch

from ggavatar.core import Camera, Gaussians
from ggavatar.geometry.transforms import look_at

RADII = (0.075, 0.11, 0.09)
FIELDS = ("means", "quats", "scales", "opacities", "colors")


def head(count: int, size: int, seed: int = 0) -> tuple[Gaussians, Camera]:
    """`count` flat Gaussians of degree 3 that require gradients, and a camera of `size` × `size` px.

    Tangential scales are 0.55 of the spacing with a log-normal spread, opacities are the sigmoid of N(0.6, 1.6).
    """
    generator = torch.Generator().manual_seed(seed)
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    radii = torch.tensor(RADII)
    normals = torch.nn.functional.normalize(directions / radii, dim=-1)
    spacing = math.sqrt(4 * math.pi * 0.09**2 / count)
    scales = 0.55 * spacing * torch.exp(0.35 * torch.randn(count, 3, generator=generator))
    scales[:, 2] *= 0.2
    forward = torch.tensor([0.0, 0.0, 1.0]).expand(count, 3)
    quats = torch.cat((1 + normals[:, 2:], torch.linalg.cross(forward, normals)), dim=1)
    opacities = torch.sigmoid(0.6 + 1.6 * torch.randn(count, generator=generator))
    colors = 0.3 * torch.randn(count, 16, 3, generator=generator)
    values = directions * radii, quats, scales, opacities, colors
    means, quats, scales, opacities, colors = (tensor.contiguous().requires_grad_() for tensor in values)
    focal = math.sqrt(0.5 * size * size / (math.pi * RADII[0] * RADII[1]))
    intrinsics = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    pose = look_at(torch.tensor([0.0, 0.0, 1.0]), torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    return Gaussians(means, quats, scales, opacities, colors), Camera(intrinsics, pose, size, size)
