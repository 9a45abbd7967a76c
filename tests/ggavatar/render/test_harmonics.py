"""Real spherical harmonics against scipy's associated Legendre functions, which have the Condon-Shortley sign."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.special import lpmv

from ggavatar.render.harmonics import sh_basis, sh_to_rgb


def expected(degree: int, order: int, directions: np.ndarray) -> np.ndarray:
    """√2 K P(cos θ) times sin |m|φ for m < 0 and cos mφ for m > 0; z is the polar axis."""
    x, y, z = directions.T
    size, angle = abs(order), np.arctan2(y, x)
    norm = math.sqrt((2 * degree + 1) / (4 * math.pi) * math.factorial(degree - size) / math.factorial(degree + size))
    around = 1.0 if order == 0 else math.sqrt(2) * (np.sin(size * angle) if order < 0 else np.cos(size * angle))
    return norm * lpmv(size, degree, z) * around


def unit_vectors(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)


def test_basis_has_3dgs_order_and_signs() -> None:
    directions = unit_vectors(50)
    columns = [
        expected(degree, order, directions.numpy()) for degree in range(4) for order in range(-degree, degree + 1)
    ]
    np.testing.assert_allclose(sh_basis(directions, 3).numpy(), np.stack(columns, axis=1), atol=1e-12)


def test_color_is_seen_from_the_camera() -> None:
    """A coefficient of the third function (z) brightens what lies beyond the camera and darkens the other side."""
    coefficients = torch.zeros(2, 4, 3, dtype=torch.float64)
    coefficients[:, 2] = 1.0
    center = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    means = center + torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -0.5]], dtype=torch.float64)
    side = math.sqrt(3 / (4 * math.pi))
    found = sh_to_rgb(coefficients, means, center, 1)
    assert torch.allclose(found[:, 0], torch.tensor([0.5 + side, 0.5 - side], dtype=torch.float64).clamp_min(0))
