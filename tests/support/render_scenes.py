"""Random scenes and gradients for the tests of the rasterizers."""

from __future__ import annotations

import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rasterizer, Rendering
from ggavatar.geometry.transforms import look_at

FIELDS = ("means", "quats", "scales", "opacities", "colors")


def random_camera(width: int, height: int, dtype: torch.dtype, focal: float = 60.0) -> Camera:
    """Off-center principal point, different focal lengths, a tilted view from 1 m."""
    intrinsics = torch.tensor([[focal, 0, 0.6 * width], [0, 0.92 * focal, 0.53 * height], [0, 0, 1]], dtype=dtype)
    eye, up = torch.tensor([0.1, 0.2, 1.0], dtype=dtype), torch.tensor([0.0, 1.0, 0.0], dtype=dtype)
    return Camera(intrinsics, look_at(eye, torch.zeros(3, dtype=dtype), up), width, height)


def random_gaussians(
    count: int,
    coefficients: int,
    dtype: torch.dtype,
    seed: int = 0,
    size: float = 0.1,
    degree: int | None = None,
    spread: float = 0.3,
) -> Gaussians:
    """Gaussians around the origin, with a spread of 0.8 partly behind `random_camera`; RGB for 0 coefficients."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator).to(dtype)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=generator).to(dtype)

    colors = 0.3 * normal(count, coefficients, 3) if coefficients else uniform(count, 3)
    return Gaussians(
        spread * normal(count, 3), normal(count, 4), 0.003 + size * uniform(count, 3), uniform(count), colors, degree
    )


def gradients(
    rasterize: Rasterizer, gaussians: Gaussians, camera: Camera, dtype: torch.dtype = torch.float32
) -> tuple[Rendering, dict[str, Tensor]]:
    """The rendering in `dtype`, and the gradients of a random linear function of image, alpha and depth, in float64."""
    leaves = {name: getattr(gaussians, name).detach().to(dtype).requires_grad_() for name in FIELDS}
    pose = camera.world_to_camera.detach().to(dtype).requires_grad_()
    background = torch.tensor([0.3, 0.9, 0.5], dtype=dtype, requires_grad=True)
    view = Camera(camera.intrinsics.to(dtype), pose, camera.width, camera.height)
    drawn = rasterize(Gaussians(**leaves, sh_degree=gaussians.sh_degree), view, background)
    generator = torch.Generator().manual_seed(7)
    loss = pose.new_zeros(())
    for output in (drawn.image, drawn.alpha, drawn.depth):
        loss = loss + (output * torch.randn(output.shape, generator=generator, dtype=torch.float64).to(dtype)).sum()
    loss.backward()
    leaves |= {"pose": pose, "background": background, "means2d": drawn.means2d}
    return drawn, {name: leaf.grad.double() for name, leaf in leaves.items() if leaf.grad is not None}


def relative_error(found: Tensor, expected: Tensor) -> float:
    """Relative L2 distance."""
    return float((found.double() - expected.double()).norm() / expected.double().norm().clamp_min(1e-30))
