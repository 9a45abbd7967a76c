"""Density control against its definition, row by row."""

from __future__ import annotations

import math

import pytest
import torch

from ggavatar.core import Rendering
from ggavatar.gaussians.density_control import (
    DensityControl,
    accumulate,
    grow,
    keep_last_per_face,
    mean_gradients,
    prune,
    reset_opacity,
    split,
    statistics,
)
from ggavatar.optim.parameters import Column, Rows


def make_rows(faces: list[int], seed: int = 0) -> Rows:
    count, generator = len(faces), torch.Generator().manual_seed(seed)
    learnable = {
        "means": Column(torch.randn(count, 3, generator=generator), 0.1),
        "quats": Column(torch.randn(count, 4, generator=generator), 0.1),
        "log_scales": Column(torch.randn(count, 3, generator=generator) - 3, 0.1),
        "opacity_logits": Column(torch.randn(count, generator=generator), 0.1),
    }
    return Rows(learnable, {"face": torch.tensor(faces), **statistics(count)})


def seen(rows: Rows, gradients: list[float]) -> None:
    """Pretend that one frame saw every row with these gradients."""
    rows["gradient"].copy_(torch.tensor(gradients))
    rows["seen"].fill_(1)


def control(**changes: float) -> DensityControl:
    values = {"start": 0, "stop": 100, "interval": 10, "reset_interval": 50, "gradient": 1.0, **changes}
    return DensityControl(**values)  # type: ignore[arg-type]


def test_statistics_are_ndc_norms_of_visible_rows() -> None:
    rows = make_rows([0, 1, 2])
    means2d = torch.zeros(3, 2, requires_grad=True)
    means2d.grad = torch.tensor([[3.0, 0.0], [0.0, 2.0], [1.0, 1.0]])
    drawn = Rendering(
        torch.zeros(20, 40, 3), torch.zeros(20, 40, 1), torch.zeros(20, 40, 1), means2d, torch.tensor([1.0, 2.0, 0.0])
    )
    accumulate(rows, drawn)
    accumulate(rows, drawn)
    assert torch.allclose(rows["gradient"], torch.tensor([2 * 3.0 * 20, 2 * 2.0 * 10, 0.0]))
    assert torch.equal(rows["seen"], torch.tensor([2.0, 2.0, 0.0]))
    assert torch.allclose(mean_gradients(rows), torch.tensor([60.0, 20.0, 0.0]))


def test_copies_are_exact_and_keep_their_face() -> None:
    rows = make_rows([3, 1, 2])
    grow(rows, torch.tensor([True, False, True]))
    assert rows["face"].tolist() == [3, 1, 2, 3, 2]
    for name, values in rows.columns().items():
        assert torch.equal(values[3:], values[[0, 2]]), name


def test_split_replaces_a_row_by_two_smaller_ones_of_its_distribution() -> None:
    rows = make_rows([0, 1])
    parent = {name: values[1].detach().clone() for name, values in rows.columns().items()}
    split(rows, torch.tensor([False, True]), torch.Generator().manual_seed(0))
    assert rows["face"].tolist() == [0, 1, 1]
    assert torch.allclose(rows["log_scales"][1:].exp(), parent["log_scales"].exp() / 1.6)
    assert torch.equal(rows["quats"][2], parent["quats"])


def test_children_spread_as_their_parent_does() -> None:
    """Sample covariance of many children against R S Sᵀ Rᵀ in the triangle's space."""
    from scipy.spatial.transform import Rotation

    rows = make_rows([0])
    rows.take(torch.zeros(20_000, dtype=torch.int64))
    mean, quat, scale = (
        rows["means"][0].detach().clone(),
        rows["quats"][0].detach(),
        rows["log_scales"][0].detach().exp(),
    )
    split(rows, torch.ones(20_000, dtype=torch.bool), torch.Generator().manual_seed(3))
    rotation = torch.from_numpy(Rotation.from_quat(quat[[1, 2, 3, 0]].numpy()).as_matrix()).float()
    expected = rotation @ torch.diag(scale**2) @ rotation.T
    sample = torch.cov((rows["means"].detach() - mean).T)
    assert torch.allclose(sample, expected, atol=0.05 * float(expected.abs().max()))


@pytest.mark.parametrize(
    ("face", "to_prune", "expected"),
    [
        ([0, 0, 1], [1, 0, 0], [1, 0, 0]),
        ([0, 0, 1], [1, 1, 0], [0, 0, 0]),
        ([0, 0, 1], [1, 0, 1], [1, 0, 0]),
        ([0, 0, 1, 1, 1], [1, 1, 1, 1, 0], [0, 0, 1, 1, 0]),
    ],
)
def test_a_face_keeps_its_last_row(face: list[int], to_prune: list[int], expected: list[int]) -> None:
    result = keep_last_per_face(torch.tensor(to_prune, dtype=torch.bool), torch.tensor(face))
    assert result.tolist() == [bool(value) for value in expected]


def test_every_face_keeps_a_row_through_random_prunings() -> None:
    generator = torch.Generator().manual_seed(5)
    rows = make_rows(torch.randint(0, 8, (200,), generator=generator).tolist() + list(range(8)))
    for _ in range(20):
        prune(rows, torch.rand(len(rows), generator=generator) < 0.5)
        assert set(rows["face"].tolist()) == set(range(8))
    assert len(rows) < 40


def test_reset_lowers_opacity_to_a_hundredth() -> None:
    rows = make_rows([0, 1, 2])
    before = rows["opacity_logits"].detach().clone()
    before[0] = rows["opacity_logits"].data[0] = -7.0
    reset_opacity(rows)
    opacity = rows["opacity_logits"].sigmoid()
    assert (opacity <= 0.01 + 1e-7).all() and rows["opacity_logits"][0] == before[0]


def test_schedule_of_rounds_and_resets() -> None:
    plan = control(start=20, stop=100, interval=10, reset_interval=50, reset_at_start=True)
    assert [step for step in range(130) if plan.is_due(step)] == [30, 40, 50, 60, 70, 80, 90]
    assert [step for step in range(130) if plan.is_active(step)] == list(range(100))
    assert [step for step in range(1, 160) if plan.resets(step)] == [20, 50]
    assert not any(control(resetting=False).resets(step) for step in range(1, 160))


@pytest.mark.parametrize("stop", [15_000, 60_000, 12_345, 12_000, 600_000])
def test_an_opacity_reset_leaves_an_interval_to_recover_in(stop: int) -> None:
    """3DGS resets every 3,000 iterations while `iteration < 15,000`, so last at 12,000."""
    interval = 3_000 if stop in (15_000, 60_000) else stop // 10
    plan = control(start=500, stop=stop, interval=100, reset_interval=interval)
    due = {500, stop, *range(interval, stop, interval)}
    resets = [step for step in sorted(due) if plan.resets(step)]
    assert resets and resets[0] == interval and stop - 2 * interval < resets[-1] <= stop - interval
    assert not plan.is_due(stop) and not plan.resets(stop)


def test_round_copies_small_and_splits_large_rows() -> None:
    rows = make_rows([0, 1, 2])
    rows["log_scales"].data.copy_(torch.tensor([[0.005] * 3, [0.5] * 3, [0.005] * 3]).log())
    rows["opacity_logits"].data.fill_(2.0)
    seen(rows, [5.0, 5.0, 0.5])
    assert control(prune_scale=1.0).apply(rows, 10, torch.ones(3), torch.Generator().manual_seed(0))
    assert rows["face"].tolist() == [0, 2, 0, 1, 1]
    assert not rows["gradient"].any() and not rows["seen"].any()


def test_world_size_decides_not_local_size() -> None:
    rows = make_rows([0, 0])
    rows["log_scales"].data.fill_(math.log(0.5))
    rows["opacity_logits"].data.fill_(2.0)
    seen(rows, [5.0, 5.0])
    control().apply(rows, 10, torch.tensor([0.01]), torch.Generator().manual_seed(0))
    assert torch.equal(rows["log_scales"], torch.full((4, 3), math.log(0.5)))


def test_budget_prefers_the_largest_gradients() -> None:
    rows = make_rows([0, 1, 2, 3])
    rows["log_scales"].data.fill_(-9.0)
    rows["opacity_logits"].data.fill_(2.0)
    seen(rows, [2.0, 5.0, 3.0, 4.0])
    control(budget=6).apply(rows, 10, torch.ones(4), torch.Generator().manual_seed(0))
    assert rows["face"].tolist() == [0, 1, 2, 3, 1, 3]


def test_faint_rows_go_and_large_ones_only_after_the_first_reset_interval() -> None:
    for step, kept in ((50, [0, 0]), (60, [0])):
        rows = make_rows([0, 0, 0])
        rows["log_scales"].data.copy_(torch.tensor([[-9.0] * 3, [0.0] * 3, [-9.0] * 3]))
        rows["opacity_logits"].data.copy_(torch.tensor([2.0, 2.0, -9.0]))
        control(resetting=False).apply(rows, step, torch.ones(1), torch.Generator().manual_seed(0))
        assert rows["face"].tolist() == kept


def test_ramp_spreads_the_budget_over_the_rounds() -> None:
    """Each round may use the room that is left divided by the rounds that are left."""
    plan, rows, counts = control(budget=37, ramp=True), make_rows(list(range(10))), []
    rows["log_scales"].data.fill_(-9.0)
    rows["opacity_logits"].data.fill_(2.0)
    for step in range(10, 100, 10):
        seen(rows, [5.0] * len(rows))
        plan.apply(rows, step, torch.ones(10), torch.Generator().manual_seed(0))
        counts.append(len(rows))
    assert counts == [13, 16, 19, 22, 25, 28, 31, 34, 37]


def rows_of(scales: list[float], opacities: list[float]) -> Rows:
    """Rows on one triangle with these standard deviations and opacities."""
    rows = make_rows([0] * len(scales))
    rows["log_scales"].data.copy_(torch.tensor(scales).log()[:, None].expand(-1, 3))
    rows["opacity_logits"].data.copy_(torch.tensor(opacities).logit())
    return rows


def test_thresholds_are_those_of_3dgs() -> None:
    """Kerbl et al. 2023 and their code, with an extent of 1 m and nothing said about thresholds.

    Gradients from 2e-4 grow; up to 0.01 of the extent a row is copied, beyond it is split; from 0.005 of opacity and
    up to 0.1 of the extent a row stays.
    """
    plan = DensityControl(start=0, stop=100, interval=10, reset_interval=20, resetting=False)
    rows = rows_of([0.009, 0.011, 0.009], [0.5, 0.5, 0.5])
    seen(rows, [2.1e-4, 2.1e-4, 1.9e-4])
    plan.apply(rows, 10, torch.ones(1), torch.Generator().manual_seed(0))
    sizes = rows["log_scales"].detach().exp()[:, 0]
    assert torch.allclose(sizes, torch.tensor([0.009, 0.009, 0.009, 0.011 / 1.6, 0.011 / 1.6]), rtol=1e-4)

    rows = rows_of([0.09, 0.11, 0.001, 0.001], [0.5, 0.5, 0.0051, 0.0049])
    plan.apply(rows, 30, torch.ones(1), torch.Generator().manual_seed(0))
    assert torch.allclose(rows["log_scales"].detach().exp()[:, 0], torch.tensor([0.09, 0.001]), rtol=1e-4)
    assert torch.allclose(rows["opacity_logits"].sigmoid(), torch.tensor([0.5, 0.0051]), rtol=1e-3)


def test_limits_are_relative_to_the_extent() -> None:
    plan = DensityControl(start=0, stop=100, interval=10, reset_interval=20, resetting=False, extent=0.1)
    rows = rows_of([0.0009, 0.0011], [0.5, 0.5])
    seen(rows, [1.0, 1.0])
    plan.apply(rows, 10, torch.ones(1), torch.Generator().manual_seed(0))
    assert len(rows) == 4 and torch.allclose(rows["log_scales"].exp()[:2, 0], torch.tensor([0.0009, 0.0009]), rtol=1e-4)
    rows = rows_of([0.009, 0.011], [0.5, 0.5])
    plan.apply(rows, 30, torch.ones(1), torch.Generator().manual_seed(0))
    assert len(rows) == 1


def test_reset_is_to_a_hundredth_and_rows_learn_from_zero_moments() -> None:
    rows = rows_of([0.01, 0.01], [0.9, 0.003])
    (rows["opacity_logits"].sum() * 2).backward()
    rows.optimizer.step()
    reset_opacity(rows)
    found = rows["opacity_logits"].sigmoid()
    assert found[0].item() == pytest.approx(0.01, rel=1e-4) and found[1].item() < 0.0031
    state = rows.optimizer.state[rows["opacity_logits"]]
    assert not state["exp_avg"].any() and not state["exp_avg_sq"].any()


def test_children_of_a_split_spread_in_units_of_their_triangle() -> None:
    """A row of 20 triangles of 1 mm is 2 cm large: its children lie about 20 triangles apart, not 0.02."""
    rows = rows_of([20.0] * 50, [0.5] * 50)
    before = rows["means"].detach().clone()
    seen(rows, [1.0] * 50)
    plan = DensityControl(start=0, stop=100, interval=10, reset_interval=20, resetting=False)
    plan.apply(rows, 10, torch.tensor([1e-3]), torch.Generator().manual_seed(0))
    apart = rows["means"].detach() - before.repeat_interleave(2, 0)
    assert len(rows) == 100 and 17 < apart.square().mean().sqrt() < 23
