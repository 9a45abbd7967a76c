"""Initial colors of Gaussians: means of training pixels, weighted by each Gaussian's contribution to each pixel."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive, Frame, Gaussians, Rasterizer

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic: color = 0.5 + SH_C0 · coefficient."""


def splatted_colors(
    pose: Callable[[Drive], Gaussians], frames: Sequence[Frame], rasterize: Rasterizer, least_weight: float = 0.1
) -> Float[Tensor, "N 3"]:
    """Mean color of the foreground pixels that a Gaussian is blended into, weighted by its contribution to them.

    The weights are the rasterizer's derivatives with respect to color, so any backend works. Pixels are weighted by
    their coverage: a Gaussian beside the person would otherwise start in the background's color, cost nothing, stay,
    and hide the person in other poses (docs/experiments/2026-11-29-initial-colors-from-the-person.md).

    Args:
        pose: Returns the Gaussians of a drive; their colors are not used.
        frames: The training frames to read colors from.
        rasterize: The rasterizer.
        least_weight: Gaussians with a smaller total weight (hidden ones, and those never in front of the person) get
            the mean color of the others.

    Returns:
        sRGB colors in [0, 1].

    Raises:
        ValueError: There is no frame.

    References:
        c = Σ w α I / Σ w α; without the mask α, RGBAvatar's start (Li et al. 2025).
    """
    totals: Tensor | None = None
    for frame in frames:
        with torch.no_grad():
            posed = pose(frame.drive)
        colors = torch.zeros_like(posed.means).requires_grad_()
        rendering = rasterize(
            dataclasses.replace(posed, colors=colors, sh_degree=None), frame.camera, torch.zeros_like(colors[0])
        )
        weighted = torch.autograd.grad(rendering.image, colors, frame.image * frame.alpha, retain_graph=True)[0]
        weight = torch.autograd.grad(rendering.image, colors, frame.alpha.expand_as(frame.image))[0]
        found = torch.cat((weighted, weight[:, :1]), dim=1)
        totals = found if totals is None else totals + found
    if totals is None:
        raise ValueError("expected at least one frame to read colors from")
    seen = totals[:, 3] > least_weight
    colors = totals[:, :3] / totals[:, 3:].clamp_min(least_weight)
    mean = colors[seen].mean(0) if bool(seen.any()) else torch.full_like(colors[0], 0.5)
    return torch.where(seen[:, None], colors, mean).clamp(0, 1)


def rgb_to_sh(colors: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Coefficients of the constant spherical harmonic for sRGB colors in [0, 1]."""
    return (colors - 0.5) / SH_C0
