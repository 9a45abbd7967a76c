"""Steps that are not finite, by the rules of the device (run on the CPU here) and of the host.

The whole of it is tested with trainings in `test_trainer.py` and `test_pretended_device.py`.
"""

from __future__ import annotations

import pytest
import torch

from ggavatar.training.finite_guard import DeviceGuard, FiniteGuard, TrainingError, clear_if, step_unless

BAD = (float("nan"), float("inf"), -float("inf"))


def model_with_gradient(value: float) -> torch.nn.Linear:
    model = torch.nn.Linear(2, 2)
    for parameter in model.parameters():
        parameter.grad = torch.ones_like(parameter)
    model.weight.grad[1, 0] = value
    return model


@pytest.mark.parametrize("value", BAD)
def test_the_device_counts_losses_and_gradients_apart(value: float) -> None:
    guard = DeviceGuard(3, torch.device("cpu"))
    assert guard.mark(torch.tensor(1.0), model_with_gradient(0.5)) == 0.0
    assert guard.mark(torch.tensor(value), model_with_gradient(0.5)) == 1.0
    assert guard.mark(torch.tensor(1.0), model_with_gradient(value)) == 1.0
    assert guard.counts.tolist() == [1.0, 1.0]
    guard.check(4, guard.counts.tolist())
    for _ in range(2):
        guard.mark(torch.tensor(1.0), model_with_gradient(value))
    with pytest.raises(TrainingError, match="step 6: a gradient is not finite; this has happened 3 times"):
        guard.check(6, guard.counts.tolist())


@pytest.mark.parametrize("kind", ["fused", "plain", "sparse"])
def test_a_bad_step_is_left_out_on_the_device(kind: str) -> None:
    """Fused Adam takes no step; an optimizer that cannot leave one out moves nothing in its first."""
    parameter = torch.nn.Parameter(torch.ones(3, 2))
    if kind == "sparse":
        optimizer: torch.optim.Optimizer = torch.optim.SparseAdam([parameter], lr=0.1)
    else:
        optimizer = torch.optim.Adam([parameter], lr=0.1, fused=kind == "fused")
    for is_bad in (1.0, 0.0):
        gradient = torch.full((3, 2), float("nan") if is_bad else 1.0)
        parameter.grad = gradient.to_sparse(1) if kind == "sparse" else gradient
        step_unless(torch.tensor(is_bad), optimizer)
        assert bool((parameter == 1).all()) == bool(is_bad) and torch.isfinite(parameter).all()
        assert not hasattr(optimizer, "found_inf")
    if kind == "fused":
        assert optimizer.state[parameter]["step"] == 1.0


def test_statistics_are_cleared_only_in_bad_steps() -> None:
    values = torch.tensor([1.0, float("nan")])
    clear_if(torch.tensor(0.0), values)
    assert values[0] == 1.0 and values[1].isnan()
    clear_if(torch.tensor(1.0), values)
    clear_if(torch.tensor(1.0), None)
    assert values.tolist() == [0.0, 0.0]


def test_the_host_names_the_term() -> None:
    with pytest.raises(TrainingError, match="loss term 'l1'"):
        FiniteGuard(1).passes(1, {"l1": torch.tensor(float("nan"))}, torch.nn.Linear(1, 1))
