"""The objective's terms in closed form, and where they could go wrong: nothing visible, nothing to push.

Also covers `ggavatar/losses/terms_kernel.py`.
"""

from __future__ import annotations

import pytest
import torch

from ggavatar.losses.terms import (
    huber,
    l1,
    log_scale_regularizer,
    log_scale_regularizer_in_torch,
    position_regularizer,
    position_regularizer_in_torch,
)

SEEN = torch.tensor([True, True, False])


def test_eq14_position_costs_beyond_the_threshold_only() -> None:
    means = torch.tensor([[0.0, -3.0, 4.0], [0.1, 0.2, -0.3], [100.0, 0.0, 0.0]], requires_grad=True)
    value = position_regularizer(means, SEEN)
    value.backward()
    assert value.item() == pytest.approx((5 - 1) / 2)  # mean over the two visible ones
    assert means.grad is not None
    assert torch.allclose(means.grad, torch.tensor([[0.0, -0.3, 0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))


def test_eq15_scale_costs_beyond_the_threshold_only() -> None:
    scales = torch.tensor([[0.9, 1.0, 0.1], [0.6, 0.2, 0.1], [9.0, 9.0, 9.0]])
    logs = scales.log().requires_grad_()
    value = log_scale_regularizer(logs, SEEN)
    value.backward()
    assert value.item() == pytest.approx(0.5 / 2)
    assert logs.grad is not None
    expected = torch.tensor([[0.3, 0.4, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert torch.allclose(logs.grad / scales, expected, atol=1e-6)


@pytest.mark.parametrize("regularizer", [position_regularizer, log_scale_regularizer])
def test_nothing_visible_costs_nothing_and_stays_in_the_graph(regularizer) -> None:
    values = torch.full((3, 3), 5.0, requires_grad=True)
    cost = regularizer(values, torch.zeros(3, dtype=torch.bool))
    cost.backward()
    assert cost.item() == 0
    assert values.grad is not None and torch.equal(values.grad, torch.zeros(3, 3))


@pytest.mark.parametrize("regularizer", [position_regularizer, log_scale_regularizer])
@pytest.mark.parametrize("fill", [0.0, 0.6, 1.0])
def test_gradients_are_finite_at_zero_and_at_the_threshold(regularizer, fill: float) -> None:
    values = torch.full((3, 3), fill, requires_grad=True)
    regularizer(values, SEEN).backward()
    assert values.grad is not None and values.grad.isfinite().all()


@pytest.mark.parametrize("regularizer", [position_regularizer, log_scale_regularizer])
def test_gradcheck(regularizer) -> None:
    values = torch.tensor([[2.0, -1.0, 0.3], [0.9, 0.7, 1.4], [3.0, 3.0, 3.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda rows: regularizer(rows, SEEN), values)


def test_l1_and_huber() -> None:
    image, target = torch.tensor([[[0.0, 0.5, 1.0]]]), torch.tensor([[[0.05, 0.5, 0.0]]])
    assert l1(image, target).item() == pytest.approx(1.05 / 3)
    assert huber(image, target).item() == pytest.approx((0.5 * 0.05**2 + 0.1 * (1 - 0.05)) / 3)


@pytest.mark.parametrize(
    ("compiled", "twin", "threshold"),
    [
        (position_regularizer, position_regularizer_in_torch, 1.0),
        (log_scale_regularizer, log_scale_regularizer_in_torch, 0.6),
    ],
)
def test_compiled_regularizers_equal_float64_autograd(compiled, twin, threshold: float) -> None:
    generator = torch.Generator().manual_seed(1)
    rows = torch.randn(20_003, 3, generator=generator).requires_grad_()
    visible = torch.rand(20_003, generator=generator) < 0.7
    wide = rows.detach().double().requires_grad_()
    ours, expected = compiled(rows, visible, threshold), twin(wide, visible, threshold)
    (3 * ours).backward()
    (3 * expected).backward()
    assert ours.item() == pytest.approx(expected.item(), rel=1e-6)
    assert rows.grad is not None and wide.grad is not None
    assert (rows.grad - wide.grad).norm() < 1e-6 * wide.grad.norm()


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 5, 1), (300, 301, 3)])
def test_compiled_l1_equals_torch(shape: tuple[int, int, int]) -> None:
    generator = torch.Generator().manual_seed(2)
    image, target = torch.rand(*shape, generator=generator), torch.rand(*shape, generator=generator)
    image[0, 0] = target[0, 0]
    other = image.clone().requires_grad_()
    image.requires_grad_()
    (2 * l1(image, target)).backward()
    expected = torch.nn.functional.l1_loss(other, target)
    (2 * expected).backward()
    assert l1(image, target).item() == pytest.approx(expected.item(), rel=1e-5)
    assert image.grad is not None and other.grad is not None
    assert torch.allclose(image.grad, other.grad, rtol=1e-5, atol=0)
