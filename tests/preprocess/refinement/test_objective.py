"""The misfit against its closed form, and its quadratic model against its gradient, in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ggavatar.core import Rendering
from preprocess.refinement.objective import (
    COVERAGE,
    NOISE,
    misfit,
    pixel_weights,
    robust_factor,
    total_weight,
    whitened,
)


def drawing(image, alpha):
    nothing = torch.zeros(0)
    return Rendering(image, alpha, torch.zeros_like(alpha), nothing.view(0, 2), nothing)


def pictures():
    generator = torch.Generator().manual_seed(0)
    image, colors = (torch.rand(6, 5, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    alpha, coverage = (torch.rand(6, 5, 1, generator=generator, dtype=torch.float64) for _ in range(2))
    weights = torch.rand(6, 5, 1, generator=generator, dtype=torch.float64)
    return image, alpha, colors, coverage, weights


def test_weights_are_those_of_face_person_and_surroundings():
    """1, 1 and 0.2; half covered pixels are half way."""
    coverage = torch.tensor([1.0, 1.0, 0.0, 0.5]).view(1, 4, 1)
    face = torch.tensor([True, False, False, True]).view(1, 4, 1)
    torch.testing.assert_close(pixel_weights(coverage, face).flatten(), torch.tensor([1.0, 1.0, 0.2, 0.6]))
    torch.testing.assert_close(pixel_weights(coverage, ~face).flatten()[[0, 3]], torch.tensor([1.0, 0.6]))


def test_misfit_is_charbonniers_penalty():
    image, alpha, colors, coverage, weights = pictures()
    total = 0.0
    for row in range(6):
        for column in range(5):
            square = ((image - colors)[row, column] ** 2).sum() + 0.3 * (alpha - coverage)[row, column, 0] ** 2
            total += float(weights[row, column, 0] / 16 * ((1 + square / 0.05**2).sqrt() - 1))
    assert float(misfit(drawing(image, alpha), colors, coverage, weights)) == pytest.approx(total, rel=1e-12)


def test_least_squares_with_the_factor_has_the_gradient_of_the_misfit():
    image, alpha, colors, coverage, weights = pictures()
    image.requires_grad_()
    drawn = drawing(image, alpha)
    (wanted,) = torch.autograd.grad(misfit(drawn, colors, coverage, weights), image)
    factor = robust_factor(drawn, colors, coverage).detach()
    (found,) = torch.autograd.grad((whitened(drawn, colors, coverage, weights).square() * factor).sum() / 2, image)
    torch.testing.assert_close(found, wanted)


def test_a_fit_costs_nothing_and_white_for_black_about_the_total_weight():
    _, _, colors, coverage, weights = pictures()
    assert float(misfit(drawing(colors, coverage), colors, coverage, weights)) == 0
    inside = torch.ones_like(coverage)
    lost = float(misfit(drawing(torch.ones_like(colors), inside), torch.zeros_like(colors), inside, weights))
    assert lost == pytest.approx(total_weight(weights) * (np.sqrt(3 + NOISE**2) - NOISE), rel=1e-6)
    assert 0 < COVERAGE < 1
