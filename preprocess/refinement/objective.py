"""How well a rendering fits a picture: a robust difference of colors and coverage that trusts the person more."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Rendering

OUTSIDE = 0.2
"""Weight of a pixel without the person; in between it follows the coverage, so that the matte's edge counts less."""
NOISE = 0.05
"""Differences above this are outliers, sRGB."""
CORRELATED = 16.0
"""Neighboring pixels err together: one of so many counts."""
COVERAGE = 0.3
"""Weight of the difference of coverage, as of one more color."""


def misfit(rendering: Rendering, colors: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W 1"]) -> Float[Tensor, ""]:
    """Negative log-likelihood of a picture: half the squared differences over `NOISE` where small, linear where large.

    This is Charbonnier's penalty of color and coverage together, weighted by pixel.
    """
    square = _relative(rendering, colors, coverage).square().sum(-1, keepdim=True)
    return (_pixel_weights(coverage) * ((1 + square).sqrt() - 1)).sum()


def whitened(
    rendering: Rendering, colors: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W 1"]
) -> Float[Tensor, "H W 4"]:
    """Differences of which half the sum of squares is the misfit where they are small."""
    return _relative(rendering, colors, coverage) * _pixel_weights(coverage).sqrt()


def robust_factor(
    rendering: Rendering, colors: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W 1"]
) -> Float[Tensor, "H W 1"]:
    """Factor on squared `whitened` differences with which least squares has the gradient of `misfit`."""
    return (1 + _relative(rendering, colors, coverage).square().sum(-1, keepdim=True)).rsqrt()


def total_weight(coverage: Float[Tensor, "H W 1"]) -> float:
    """Weight of all pixels over `NOISE`: the misfit of a picture that is off by 1 everywhere is about this much."""
    return float(_pixel_weights(coverage).sum()) / NOISE


def _relative(rendering: Rendering, colors: Tensor, coverage: Tensor) -> Float[Tensor, "H W 4"]:
    return torch.cat((rendering.image - colors, COVERAGE**0.5 * (rendering.alpha - coverage)), dim=-1) / NOISE


def _pixel_weights(coverage: Tensor) -> Float[Tensor, "H W 1"]:
    return (OUTSIDE + (1 - OUTSIDE) * coverage) / CORRELATED
