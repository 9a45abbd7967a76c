"""The hidden layer of lower rank: exact at full rank, and no worse than other choices in what it minimizes."""

from __future__ import annotations

import pytest
import torch

from ggavatar.formats.web.reduction import reduced
from ggavatar.gaussians.bound_parts import AdjusterParts


def adjuster(seed: int = 0, rows: int = 13, hidden: int = 12, true_rank: int = 12) -> AdjusterParts:
    """Random parts whose hidden layer has a rank and a mean."""
    random = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random)

    features = normal(300, true_rank) @ normal(true_rank, hidden) + normal(hidden)
    layers = ((normal(4, 5), normal(4)),)
    return AdjusterParts(features, normal(rows, 4, hidden), normal(rows, 4), layers, 0.01, 0.1, False)


def rows_of(parts: AdjusterParts, latents: torch.Tensor) -> torch.Tensor:
    """Offsets of all frames and Gaussians, in units of equal cost."""
    weight = torch.einsum("tl,rlh->trh", latents, parts.last_weight)
    values = torch.einsum("trh,nh->tnr", weight, parts.hidden) + (latents @ parts.last_bias.T)[:, None]
    costs = torch.tensor([10.0] * 3 + [3.0] * 7 + [1.0] * (values.shape[2] - 10))
    return values * costs


def test_a_hidden_layer_of_that_rank_loses_nothing() -> None:
    whole, latents = adjuster(true_rank=5), torch.randn(50, 4, generator=torch.Generator().manual_seed(1))
    small = reduced(whole, latents, 5)
    assert small.hidden.shape == (300, 5) and small.last_weight.shape == (13, 4, 5)
    torch.testing.assert_close(rows_of(small, latents), rows_of(whole, latents), atol=2e-3, rtol=1e-4)


def test_it_is_returned_unchanged_where_it_is_narrow() -> None:
    whole = adjuster()
    assert reduced(whole, torch.randn(3, 4), 12) is whole


@pytest.mark.parametrize("rank", [2, 6])
def test_no_other_projection_is_better(rank: int) -> None:
    whole, latents = adjuster(), torch.randn(80, 4, generator=torch.Generator().manual_seed(2))
    latents = latents * torch.tensor([3.0, 1.0, 0.1, 0.0])  # some directions hardly matter
    truth = rows_of(whole, latents)
    best = float((rows_of(reduced(whole, latents, rank), latents) - truth).square().mean())
    plain = reduced(whole, latents, 12)
    mean = whole.hidden.mean(0)
    left, values, right = torch.linalg.svd(whole.hidden - mean, full_matrices=False)
    principal = left[:, :rank] * values[:rank] @ right[:rank] + mean  # components of h itself, blind to what uses it
    other = AdjusterParts(principal, whole.last_weight, whole.last_bias, whole.latent_layers, 0.01, 0.1, False)
    assert 0 < best < 0.999 * float((rows_of(other, latents) - truth).square().mean())
    assert float((rows_of(plain, latents) - truth).square().mean()) == 0
