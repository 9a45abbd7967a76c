"""The regularizers' Triton kernels, interpreted, against the torch twins in float64; compiled without spilling."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.losses import terms
from tests.support.kernel_compiler import recorded_launches
from tests.support.triton_kernels import interpreted

pytestmark = interpreted
TERMS = {
    "position": (terms.position_regularizer, terms.position_regularizer_in_torch, 1.0),
    "log scale": (terms.log_scale_regularizer, terms.log_scale_regularizer_in_torch, 0.6),
}


@pytest.fixture(autouse=True)
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU tensors take the way of those on CUDA."""
    monkeypatch.setattr(terms, "compiled_for", lambda *_: False)
    monkeypatch.setattr(device_kernels, "run_on", lambda *_: True)


def rows_and_flags(count: int) -> tuple[Tensor, Tensor]:
    """Rows on both sides of the thresholds; some are zero, and half are visible."""
    generator = torch.Generator().manual_seed(count)
    rows = torch.randn(count, 3, generator=generator)
    rows[::5] = 0.0
    return rows, torch.rand(count, generator=generator) < 0.5


@pytest.mark.parametrize("kind", TERMS)
@pytest.mark.parametrize("count", [1, 255, 700])
def test_mean_and_gradient_equal_the_twin_in_float64(kind: str, count: int) -> None:
    ours, twin, threshold = TERMS[kind]
    rows, visible = rows_and_flags(count)
    leaf, wide = rows.clone().requires_grad_(), rows.double().requires_grad_()
    with recorded_launches() as launches:
        found = ours(leaf, visible, weight=0.3)
        (-1.7 * found).backward()
    assert [launch.name for launch in launches] == ["sum_costs", "finish_mean", "differentiate_costs"]
    expected = 0.3 * twin(wide, visible, threshold)
    (-1.7 * expected).backward()
    assert leaf.grad is not None and wide.grad is not None and torch.isfinite(leaf.grad).all()
    assert found.item() == pytest.approx(expected.item(), rel=1e-5, abs=1e-9)
    torch.testing.assert_close(leaf.grad.double(), wide.grad, atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("kind", TERMS)
def test_nothing_visible_costs_nothing(kind: str) -> None:
    leaf = torch.full((300, 3), 2.0, requires_grad=True)
    cost = TERMS[kind][0](leaf, torch.zeros(300, dtype=torch.bool))
    cost.backward()
    assert cost.item() == 0.0 and leaf.grad is not None and not leaf.grad.any()


def test_kernels_compile_without_spilling(registers_of: Callable[..., dict[str, int]]) -> None:
    rows, visible = rows_and_flags(4)
    with recorded_launches() as launches:
        for ours, _, _ in TERMS.values():
            ours(rows.clone().requires_grad_(), visible).backward()
    found = registers_of(launches)
    assert found.keys() == {"sum_costs", "finish_mean", "differentiate_costs"} and max(found.values()) <= 48, found
