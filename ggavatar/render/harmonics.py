"""Real spherical harmonics up to degree 3, in 3D Gaussian splatting's order and with its signs."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def sh_basis(directions: Float[Tensor, "N 3"], degree: int) -> Float[Tensor, "N K"]:
    """Values of the (degree + 1)² basis functions.

    Args:
        directions: Unit vectors from the camera to the Gaussians.
        degree: Highest degree, 0 to 3.

    Returns:
        Columns in 3DGS's order Y00, Y1-1, Y10, Y11, Y2-2, …, Y33, with the Condon-Shortley sign.
    """
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, C0)]
    if degree >= 1:
        values += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        values += [
            C2[0] * x * y,
            -C2[0] * y * z,
            C2[1] * (2 * z * z - x * x - y * y),
            -C2[0] * x * z,
            C2[2] * (x * x - y * y),
        ]
    if degree >= 3:
        values += [
            -C3[0] * y * (3 * x * x - y * y),
            C3[1] * x * y * z,
            -C3[2] * y * (4 * z * z - x * x - y * y),
            C3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -C3[2] * x * (4 * z * z - x * x - y * y),
            C3[4] * z * (x * x - y * y),
            -C3[0] * x * (x * x - 3 * y * y),
        ]
    return torch.stack(values, dim=-1)


def used_degree(coefficients: int, wanted: int | None) -> int:
    """Degree to evaluate, given the number of coefficients per channel and the wanted degree (None: the highest).

    Raises:
        ValueError: The number is not 1, 4, 9 or 16, or the wanted degree needs more coefficients.
    """
    highest = math.isqrt(coefficients) - 1
    if (highest + 1) ** 2 != coefficients or not 0 <= highest <= 3:
        raise ValueError(f"expected 1, 4, 9 or 16 spherical-harmonics coefficients per channel, got {coefficients}")
    if wanted is None:
        return highest
    if not 0 <= wanted <= highest:
        raise ValueError(f"expected sh_degree of 0 to {highest} for {coefficients} coefficients, got {wanted}")
    return wanted


def sh_to_rgb(
    coefficients: Float[Tensor, "N K 3"], means: Float[Tensor, "N 3"], center: Float[Tensor, " 3"], degree: int
) -> Float[Tensor, "N 3"]:
    """Colors max(0, SH + 0.5) of Gaussians seen from a camera at `center` (world, m)."""
    offsets = means - center
    directions = offsets / offsets.norm(dim=-1, keepdim=True).clamp_min(1e-20)
    basis = sh_basis(directions, degree)
    return ((basis[:, :, None] * coefficients[:, : basis.shape[1]]).sum(1) + 0.5).clamp_min(0)
