"""The objective's terms in closed form, and where they could go wrong: nothing visible, nothing to push."""

from __future__ import annotations

import pytest
import torch

from ggavatar.losses import huber, l1, position_regulariser, scale_regulariser

SEEN = torch.tensor([True, True, False])


def test_eq14_position_costs_beyond_the_threshold_only() -> None:
    means = torch.tensor([[0.0, -3.0, 4.0], [0.1, 0.2, -0.3], [100.0, 0.0, 0.0]], requires_grad=True)
    value = position_regulariser(means, SEEN)
    value.backward()
    assert value.item() == pytest.approx((5 - 1) / 2)  # mean over the two visible ones
    assert means.grad is not None
    assert torch.allclose(means.grad, torch.tensor([[0.0, -0.3, 0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))


def test_eq15_scale_costs_beyond_the_threshold_only() -> None:
    scales = torch.tensor([[0.9, 1.0, 0.1], [0.6, 0.2, 0.1], [9.0, 9.0, 9.0]], requires_grad=True)
    value = scale_regulariser(scales, SEEN)
    value.backward()
    assert value.item() == pytest.approx(0.5 / 2)
    assert scales.grad is not None
    assert torch.allclose(scales.grad, torch.tensor([[0.3, 0.4, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))


@pytest.mark.parametrize("regulariser", [position_regulariser, scale_regulariser])
def test_nothing_visible_costs_nothing_and_stays_in_the_graph(regulariser) -> None:
    values = torch.full((3, 3), 5.0, requires_grad=True)
    cost = regulariser(values, torch.zeros(3, dtype=torch.bool))
    cost.backward()
    assert cost.item() == 0
    assert values.grad is not None and torch.equal(values.grad, torch.zeros(3, 3))


@pytest.mark.parametrize("regulariser", [position_regulariser, scale_regulariser])
@pytest.mark.parametrize("fill", [0.0, 0.6, 1.0])
def test_gradients_are_finite_at_zero_and_at_the_threshold(regulariser, fill: float) -> None:
    values = torch.full((3, 3), fill, requires_grad=True)
    regulariser(values, SEEN).backward()
    assert values.grad is not None and values.grad.isfinite().all()


@pytest.mark.parametrize("regulariser", [position_regulariser, scale_regulariser])
def test_gradcheck(regulariser) -> None:
    values = torch.tensor([[2.0, -1.0, 0.3], [0.9, 0.7, 1.4], [3.0, 3.0, 3.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda rows: regulariser(rows, SEEN), values)


def test_l1_and_huber() -> None:
    image, target = torch.tensor([[[0.0, 0.5, 1.0]]]), torch.tensor([[[0.05, 0.5, 0.0]]])
    assert l1(image, target).item() == pytest.approx(1.05 / 3)
    assert huber(image, target).item() == pytest.approx((0.5 * 0.05**2 + 0.1 * (1 - 0.05)) / 3)
