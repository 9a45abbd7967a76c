"""Schedules against the paper's numbers."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from ggavatar.errors import InputError
from ggavatar.optim.schedules import log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.training.plan import TrainingPlan, preset
from ggavatar.training.trainer import step_with_rate_factor


def test_a_preset_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match=r"preset 'fas': expected one of default, fast, paper \(did you mean fast\?\)"):
        preset("fas", "cpu")


def test_position_rate_reaches_a_hundredth_at_half() -> None:
    assert log_linear(0, 5e-3, 5e-5, 60_000) == pytest.approx(5e-3)
    assert log_linear(30_000, 5e-3, 5e-5, 60_000) == pytest.approx(5e-4)
    for step in (60_000, 120_000):
        assert log_linear(step, 5e-3, 5e-5, 60_000) == pytest.approx(5e-5)


def test_constants_scale_with_the_length() -> None:
    assert [scaled(5_000, steps) for steps in (120_000, 12_000, 1_200)] == [5_000, 500, 50]


def test_coarse_to_fine_in_thirds() -> None:
    plan = TrainingPlan(steps=100, resolutions=((0.25, 0.25), (0.25, 0.5)), smallest=64)
    sizes = [plan.size_at(step, 512, 256) for step in (1, 25, 26, 50, 51, 100)]
    assert sizes == [(128, 64)] * 2 + [(256, 128)] * 2 + [(512, 256)] * 2


def test_small_frames_are_not_shrunk_below_the_limit() -> None:
    plan = TrainingPlan(steps=100, resolutions=((0.5, 0.25),), smallest=128)
    assert plan.size_at(1, 160, 160) == (128, 128)
    assert plan.size_at(1, 48, 48) == (48, 48)


def test_paper_preset_is_as_printed() -> None:
    plan = preset("paper", "cpu")
    assert (plan.steps, plan.resolutions) == (120_000, ())
    assert plan.rate_factor(1) == plan.rate_factor(120_000) == 1


def test_rates_cool_down_by_half_a_cosine() -> None:
    plan = TrainingPlan(steps=1_000, cooling=0.4, coolest=0.02)
    assert plan.rate_factor(1) == plan.rate_factor(600) == 1
    assert plan.rate_factor(800) == pytest.approx(0.51)
    assert plan.rate_factor(1_000) == pytest.approx(0.02)
    factors = [plan.rate_factor(step) for step in range(1, 1_001)]
    assert factors == sorted(factors, reverse=True)


@given(steps=st.integers(1, 400), cooling=st.floats(0, 1), coolest=st.floats(0, 1))
def test_factors_on_rates_stay_between_the_coolest_and_one(steps: int, cooling: float, coolest: float) -> None:
    plan = TrainingPlan(steps=steps, cooling=cooling, coolest=coolest)
    assert all(coolest - 1e-9 <= plan.rate_factor(step) <= 1 + 1e-9 for step in range(1, steps + 1))


def test_generators_depend_on_seed_and_stream_alone() -> None:
    def draw(*key: int) -> list[float]:
        return torch.rand(4, generator=seeded(*key)).tolist()

    assert draw(42, 1, 7) == draw(42, 1, 7)
    different = [draw(42, 1, 7), draw(43, 1, 7), draw(42, 2, 7), draw(42, 1, 8), draw(42, 7, 1)]
    assert len({tuple(values) for values in different}) == 5


def test_a_step_at_a_factor_leaves_the_rate_alone() -> None:
    weight = torch.nn.Parameter(torch.tensor([1.0]))
    optimizer = torch.optim.SGD([weight], lr=0.5)
    weight.grad = torch.tensor([1.0])
    step_with_rate_factor(optimizer, 0.1)
    assert weight.item() == pytest.approx(0.95)
    assert optimizer.param_groups[0]["lr"] == 0.5


def test_default_plan_is_coarse_to_fine_and_cools() -> None:
    """The figures of docs/experiments: a quarter of the size, then half, and a decay over the last 40 % to 2 %."""
    for plan in (preset("default", "cpu"), preset("fast", "cpu")):
        assert [plan.size_at(share * plan.steps // 100, 512, 512)[0] for share in (1, 25, 26, 50, 51, 100)] == [
            128, 128, 256, 256, 512, 512,
        ]  # fmt: skip
        assert plan.rate_factor(round(0.6 * plan.steps)) == 1
        assert plan.rate_factor(round(0.8 * plan.steps)) == pytest.approx(0.51, abs=1e-3)
        assert plan.rate_factor(plan.steps) == pytest.approx(0.02)
