"""A fused step of all groups against `torch.optim.Adam` itself, bit by bit."""

from __future__ import annotations

import pytest
import torch

from ggavatar.optim.fused_adam import fused_adam_step


def optimizer_of(values: list[torch.Tensor], **options: bool) -> torch.optim.Adam:
    groups = [{"params": [torch.nn.Parameter(value.clone())], "lr": 0.1 / (k + 1)} for k, value in enumerate(values)]
    groups[-1]["eps"] = 1e-15
    groups.append({"params": [torch.nn.Parameter(torch.ones(2))], "lr": 1.0})  # never gets a gradient
    return torch.optim.Adam(groups, betas=(0.8, 0.95), **{"fused": True, **options})


def parameters(optimizer: torch.optim.Adam) -> list[torch.nn.Parameter]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]


def test_steps_equal_those_of_torch_and_bad_ones_change_nothing() -> None:
    generator = torch.Generator().manual_seed(0)
    values = [torch.randn(5, 3, generator=generator), torch.randn(7, generator=generator)]
    ours, theirs = optimizer_of(values), optimizer_of(values)
    for step, bad in enumerate((0.0, 0.0, 1.0, 0.0, 1.0, 0.0)):
        for k, value in enumerate(values):
            gradient = torch.randn(value.shape, generator=generator) if not bad else torch.full(value.shape, torch.nan)
            for optimizer in (ours, theirs):
                parameters(optimizer)[k].grad = gradient.clone()
        taken = fused_adam_step(ours, torch.tensor(bad))
        assert taken == (step > 0), "torch itself makes the state, in the first step"
        if not taken:
            ours.step()
        theirs.found_inf = torch.tensor(bad)
        theirs.step()
        del theirs.found_inf
    for one, other in zip(parameters(ours), parameters(theirs), strict=True):
        torch.testing.assert_close(one, other, atol=0, rtol=0)
        assert ours.state[one].keys() == theirs.state[other].keys()
        for name, value in ours.state[one].items():
            torch.testing.assert_close(value, theirs.state[other][name], atol=0, rtol=0)
    assert ours.state[parameters(ours)[0]]["step"] == 4.0


@pytest.mark.parametrize("options", [{"fused": False}, {"amsgrad": True}])
def test_other_optimizers_are_left_to_torch(options: dict[str, bool]) -> None:
    optimizer = optimizer_of([torch.ones(3)], **options)
    parameters(optimizer)[0].grad = torch.ones(3)
    optimizer.step()
    assert not fused_adam_step(optimizer, torch.tensor(0.0))
    assert not fused_adam_step(torch.optim.SGD(parameters(optimizer)), torch.tensor(0.0))
