"""Fewer columns of the adjuster's hidden layer: the rank that matters for the offsets of the training frames."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.gaussians.bound_parts import AdjusterParts
from ggavatar.gaussians.offsets import GEOMETRY_ROWS

POSITION, ROTATION, LOG_SCALE, COLOR = 1000.0, 3.0, 3.0, 10.0
"""What an error costs: per m of position, per unit of quaternion and of log-scale, per unit of sRGB.

A millimeter of position weighs as much as a turn by 40°, a growth by 40 % or a tenth of the color range.
"""

RIDGE = 1e-9
"""Added to the diagonal, so that directions that no frame uses can be inverted."""


def reduced(parts: AdjusterParts, latents: Float[Tensor, "T L"], rank: int) -> AdjusterParts:
    """The adjuster with `rank` hidden columns, the closest in the offsets that the latent vectors of T frames give.

    Let G = mean Mᵀ M over frames, M = A f weighted by cost, and G = L Lᵀ. The error of h ≈ h̄ + z P is then
    |(h − h̄ − z P) L|; the SVD of (h − h̄) L makes it least (Eckart and Young). A hidden layer that is no wider is
    returned unchanged.
    """
    hidden = parts.hidden.double()
    if rank >= hidden.shape[1]:
        return parts
    weight, bias = parts.last_weight.double(), parts.last_bias.double()
    frames = torch.einsum("tl,rlh->trh", latents.double(), weight) * _costs(parts)[:, None]
    gram = torch.einsum("trh,trk->hk", frames, frames) / len(frames)
    factor = torch.linalg.cholesky(gram + RIDGE * torch.eye(len(gram)).to(gram))
    mean = hidden.mean(0)
    left, values, right = torch.linalg.svd((hidden - mean) @ factor, full_matrices=False)
    back = torch.linalg.solve_triangular(factor, right[:rank], upper=False, left=False)
    return dataclasses.replace(
        parts,
        hidden=(left[:, :rank] * values[:rank]).float(),
        last_weight=(weight @ back.T).float(),
        last_bias=(bias + weight @ mean).float(),
    )


def _costs(parts: AdjusterParts) -> Float[Tensor, " R"]:
    """The cost of a unit of every row."""
    rows = [POSITION * parts.unit] * 3 + [ROTATION] * 4 + [LOG_SCALE] * 3
    rows += [COLOR * parts.color_unit] * (len(parts.last_bias) - GEOMETRY_ROWS)
    return torch.tensor(rows, dtype=torch.float64, device=parts.last_bias.device)
