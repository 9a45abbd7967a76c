"""Rows against plain indexing and against torch.optim.Adam on each row alone."""

from __future__ import annotations

import copy
import subprocess
import sys

import pytest
import torch

from ggavatar.optim.parameters import Column, Rows


def make_rows(count: int = 6) -> Rows:
    generator = torch.Generator().manual_seed(1)
    learnable = {
        "means": Column(torch.randn(count, 3, generator=generator), 0.1),
        "weights": Column(torch.randn(count, generator=generator), 0.01),
    }
    return Rows(learnable, {"face": torch.arange(count), "seen": torch.zeros(count)})


def pull(rows: Rows, steps: int = 3) -> None:
    """A few steps toward 1 on every learnable column, each row with a strength of its own."""
    for _ in range(steps):
        strength = 1 + rows["face"].to(torch.float32)
        loss = (strength[:, None] * (rows["means"] - 1) ** 2).sum() + (strength * (rows["weights"] - 1) ** 2).sum()
        rows.optimizer.zero_grad()
        loss.backward()
        rows.optimizer.step()


def moments(rows: Rows, name: str) -> torch.Tensor:
    return rows.optimizer.state[rows[name]]["exp_avg"]


def test_unequal_columns_are_refused() -> None:
    with pytest.raises(ValueError, match="equal length"):
        Rows({"means": Column(torch.zeros(3, 3), 0.1)}, {"face": torch.arange(4)})


def test_take_keeps_values_and_moments_of_the_remaining_rows() -> None:
    rows = make_rows()
    pull(rows)
    values = {name: column.detach().clone() for name, column in rows.columns().items()}
    before = {name: moments(rows, name).clone() for name in ("means", "weights")}
    index = torch.tensor([4, 0, 2])
    rows.take(index)
    assert len(rows) == 3
    for name, column in rows.columns().items():
        assert torch.equal(column, values[name][index])
    for name in before:
        assert before[name].abs().min() > 0
        assert torch.equal(moments(rows, name), before[name][index])


def test_remaining_rows_train_on_as_before() -> None:
    """Adam is row-wise, so training on, then taking, equals taking, then training on."""
    early, late = make_rows(), make_rows()
    index = torch.tensor([5, 1, 3])
    pull(early)
    early.take(index)
    pull(early)
    pull(late, 6)
    late.take(index)
    assert torch.allclose(early["means"], late["means"], rtol=1e-6)
    assert torch.allclose(early["weights"], late["weights"], rtol=1e-6)


def test_append_starts_new_rows_at_zero_moments() -> None:
    rows = make_rows()
    pull(rows)
    before = moments(rows, "means").clone()
    rows.append({name: values[:2] for name, values in rows.columns().items()})
    assert len(rows) == 8
    assert torch.equal(moments(rows, "means")[:6], before)
    assert torch.equal(moments(rows, "means")[6:], torch.zeros(2, 3))
    assert torch.equal(rows["face"], torch.tensor([0, 1, 2, 3, 4, 5, 0, 1]))
    pull(rows)
    assert moments(rows, "means")[6:].abs().min() > 0


def test_append_wants_every_column() -> None:
    with pytest.raises(ValueError, match="columns"):
        make_rows().append({"means": torch.zeros(1, 3)})


def test_replace_forgets_the_moments() -> None:
    rows = make_rows()
    pull(rows)
    rows.replace("weights", torch.full((6,), 7.0))
    assert torch.equal(rows["weights"], torch.full((6,), 7.0))
    assert not moments(rows, "weights").any() and moments(rows, "means").any()


def test_rates_belong_to_columns() -> None:
    rows = make_rows()
    rows.set_rate("means", 0.5)
    assert (rows.rate("means"), rows.rate("weights")) == (0.5, 0.01)
    with pytest.raises(KeyError, match="means"):
        rows.set_rate("colors", 1.0)


def test_state_with_another_number_of_rows_loads() -> None:
    source, target = make_rows(9), make_rows(4)
    pull(target)
    target.load_state_dict(source.state_dict())
    assert len(target) == 9
    for name, column in source.columns().items():
        assert torch.equal(target[name], column)
    pull(target)


def test_optimizer_state_survives_a_change_of_rows() -> None:
    """Save after growing, load into a new object, and continue bit-identically."""
    source, target = make_rows(), make_rows()
    pull(source)
    source.append({name: values[:3] for name, values in source.columns().items()})
    pull(source)
    target.load_state_dict(source.state_dict())
    target.optimizer.load_state_dict(copy.deepcopy(source.optimizer.state_dict()))
    pull(source)
    pull(target)
    assert torch.equal(source["means"], target["means"])


def test_adam_of_rows_is_that_of_3dgs() -> None:
    """β of 0.9 and 0.999, ε of 1e-15: a gradient of 1e-10 moves a row by its rate, not by a hundredth of it."""
    rows = make_rows()
    before = rows["means"].detach().clone()
    (1e-10 * rows["means"].sum()).backward()
    rows.optimizer.step()
    assert torch.allclose(before - rows["means"], torch.full((6, 3), 0.1), rtol=1e-3)
    assert {group["betas"] for group in rows.optimizer.param_groups} == {(0.9, 0.999)}


def test_there_is_no_optimizer_before_it_is_used() -> None:
    """Rows that are only loaded and rendered import nothing of torch's compiler, in a process of its own."""
    code = (
        "import sys, torch\n"
        "from ggavatar.optim.parameters import Column, Rows\n"
        "rows = Rows({'x': Column(torch.zeros(2, 3), 0.1)})\n"
        "rows.load_state_dict({'learnable.x': torch.ones(5, 3)})\n"
        "rows.set_rate('x', 0.5)\n"
        "assert len(rows) == 5 and rows.rate('x') == 0.5 and 'torch._dynamo' not in sys.modules\n"
        "group = rows.optimizer.param_groups[0]\n"
        "assert group['lr'] == 0.5 and group['params'][0] is rows['x'] and 'torch._dynamo' in sys.modules\n"
        "rows['x'].sum().backward(); rows.optimizer.step(); rows.take(torch.tensor([1]))\n"
        "assert rows.optimizer.state[rows['x']]['exp_avg'].shape == (1, 3)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
