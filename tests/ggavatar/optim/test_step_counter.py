"""The step count: part of the state, and on the CPU wherever the parameters are."""

from __future__ import annotations

import torch

from ggavatar.optim.step_counter import StepCounter


class Counted(StepCounter):
    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(2))


def test_the_count_stays_on_the_cpu() -> None:
    """`meta` is another device that every computer has."""
    moved = Counted().to("meta")
    assert moved.weight.device.type == "meta" and moved.steps_done.device.type == "cpu"
    moved.steps_done.fill_(7)
    assert int(moved.steps_done) == 7


def test_the_count_stays_an_integer() -> None:
    assert Counted().half().steps_done.dtype is torch.int64


def test_the_count_is_saved_and_loaded() -> None:
    counted, other = Counted(), Counted()
    counted.steps_done.fill_(41)
    other.load_state_dict(counted.state_dict())
    assert int(other.steps_done) == 41 and list(counted.state_dict()) == ["weight", "steps_done"]
