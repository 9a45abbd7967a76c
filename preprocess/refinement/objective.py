"""How well a rendering fits a picture: a robust difference of colors and coverage, weighted by pixel.

The person counts more than what is around it; hair and clothes, which move on their own, can count less than the face.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ggavatar.core import Rendering

OUTSIDE, BESIDE = 0.2, 1.0
"""Weights of a pixel without the person, and of one of the person beside the face, whose weight is 1.

Beside the face, 0.2 gave better poses under long hair and no pictures were trained with it
(docs/experiments/2026-11-30-photometric-refinement.md).
"""
NOISE = 0.05
"""Differences above this are outliers, sRGB."""
CORRELATED = 16.0
"""Neighboring pixels err together: one of so many counts."""
COVERAGE = 0.3
"""Weight of the difference of coverage, as of one more color."""


def pixel_weights(coverage: Float[Tensor, "H W 1"], face: Bool[Tensor, "H W 1"]) -> Float[Tensor, "H W 1"]:
    """Weight of every pixel; it follows the coverage, so that the matte's edge counts less."""
    return OUTSIDE + torch.where(face, 1 - OUTSIDE, BESIDE - OUTSIDE) * coverage


def misfit(
    rendering: Rendering, colors: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W 1"], weights: Tensor
) -> Float[Tensor, ""]:
    """Negative log-likelihood of a picture: half the squared differences over `NOISE` where small, linear where large.

    This is Charbonnier's penalty of color and coverage together, weighted by pixel.
    """
    square = _relative(rendering, colors, coverage).square().sum(-1, keepdim=True)
    return (weights / CORRELATED * ((1 + square).sqrt() - 1)).sum()


def whitened(
    rendering: Rendering, colors: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W 1"], weights: Tensor
) -> Float[Tensor, "H W 4"]:
    """Differences of which half the sum of squares is the misfit where they are small."""
    return _relative(rendering, colors, coverage) * (weights / CORRELATED).sqrt()


def robust_factor(
    rendering: Rendering, colors: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W 1"]
) -> Float[Tensor, "H W 1"]:
    """Factor on squared `whitened` differences with which least squares has the gradient of `misfit`."""
    return (1 + _relative(rendering, colors, coverage).square().sum(-1, keepdim=True)).rsqrt()


def total_weight(weights: Float[Tensor, "H W 1"]) -> float:
    """All pixels over `NOISE`: the misfit of a picture that is off by 1 everywhere is about this much."""
    return float(weights.sum()) / CORRELATED / NOISE


def _relative(rendering: Rendering, colors: Tensor, coverage: Tensor) -> Float[Tensor, "H W 4"]:
    return torch.cat((rendering.image - colors, COVERAGE**0.5 * (rendering.alpha - coverage)), dim=-1) / NOISE
