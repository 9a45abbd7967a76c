"""Row-aligned tensors, one row per Gaussian, together with the state of their optimizer.

Learnable columns are optimized, each at its own rate; carried columns (a face index, a statistic) only follow the rows.
Adding and removing rows keeps the optimizer's moments of the remaining rows and starts new rows at zero, as in 3D
Gaussian Splatting's density control.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from jaxtyping import Int
from torch import Tensor, nn


class Column(NamedTuple):
    """Initial values and learning rate of a learnable column.

    Attributes:
        values: Initial values; the first dimension is the row.
        rate: Learning rate, in the column's unit.
    """

    values: Tensor
    rate: float


class Rows(nn.Module):
    """Row-aligned learnable and carried columns, with one optimizer for all learnable ones.

    The optimizer is made when it is first used: an avatar that is only rendered has none, which saves the second in
    which the first optimizer of a process imports torch's compiler.
    The number of rows is part of the state: `load_state_dict` accepts any number and resizes the object to it.
    """

    def __init__(
        self,
        learnable: Mapping[str, Column],
        carried: Mapping[str, Tensor] | None = None,
        make_optimizer: Callable[[list[dict[str, Any]]], torch.optim.Optimizer] | None = None,
    ) -> None:
        """Copy the columns.

        Args:
            learnable: Columns to optimize, by name.
            carried: Columns that follow the rows without being optimized, by name.
            make_optimizer: Called with parameter groups (`params`, `lr`, `name`); default Adam with ε = 1e-15 (3DGS).

        Raises:
            ValueError: The columns differ in length.
        """
        super().__init__()
        self.learnable = nn.ParameterDict(
            {name: nn.Parameter(column.values.detach().clone()) for name, column in learnable.items()}
        )
        self.carried = nn.Module()
        for name, values in (carried or {}).items():
            self.carried.register_buffer(name, values.detach().clone())
        counts = {name: len(values) for name, values in self.columns().items()}
        if len(set(counts.values())) != 1:
            raise ValueError(f"expected columns of equal length, got {counts}")
        self._first_groups = [
            {"params": [self.learnable[name]], "lr": column.rate, "name": name} for name, column in learnable.items()
        ]
        self._make_optimizer = make_optimizer or _adam
        self._optimizer: torch.optim.Optimizer | None = None
        self.register_load_state_dict_pre_hook(_resize_to_state)

    def __len__(self) -> int:
        return len(next(iter(self.learnable.values())))

    def __getitem__(self, name: str) -> Tensor:
        return self.learnable[name] if name in self.learnable else self.carried.get_buffer(name)

    @property
    def optimizer(self) -> torch.optim.Optimizer:
        """The optimizer of the learnable columns."""
        if self._optimizer is None:
            self._optimizer = self._make_optimizer(self._first_groups)
        return self._optimizer

    @property
    def _groups(self) -> list[dict[str, Any]]:
        """The parameter groups: those of the optimizer once there is one."""
        return self._first_groups if self._optimizer is None else self._optimizer.param_groups

    @property
    def _state(self) -> dict[Any, Any]:
        """The optimizer's state by parameter; empty before there is one."""
        return {} if self._optimizer is None else self._optimizer.state

    def columns(self) -> dict[str, Tensor]:
        """Every column by name, learnable ones first."""
        return {**dict(self.learnable.items()), **dict(self.carried.named_buffers())}

    def set_rate(self, name: str, rate: float) -> None:
        """Set the learning rate of a learnable column."""
        self._group(name)["lr"] = rate

    def rate(self, name: str) -> float:
        """Learning rate of a learnable column."""
        return float(self._group(name)["lr"])

    @torch.no_grad()
    def take(self, index: Int[Tensor, " M"]) -> None:
        """Keep the rows at `index`, in that order, with their optimizer state."""
        self._transform(lambda _, values: values[index], lambda moments: moments[index])

    @torch.no_grad()
    def append(self, new_rows: Mapping[str, Tensor]) -> None:
        """Add rows at the end, with zero moments.

        Args:
            new_rows: Values of every column by name.

        Raises:
            ValueError: A column is missing or unknown.
        """
        if set(new_rows) != set(self.columns()):
            raise ValueError(f"expected the columns {sorted(self.columns())}, got {sorted(new_rows)}")
        count = len(next(iter(new_rows.values())))
        self._transform(
            lambda name, values: torch.cat((values, new_rows[name].to(values.dtype))),
            lambda moments: torch.cat((moments, moments.new_zeros(count, *moments.shape[1:]))),
        )

    @torch.no_grad()
    def replace(self, name: str, values: Tensor) -> None:
        """Overwrite a learnable column and zero its moments."""
        self.learnable[name].copy_(values)
        for moments in self._row_state(self.learnable[name]).values():
            moments.zero_()

    def _transform(self, column: Callable[[str, Tensor], Tensor], moments: Callable[[Tensor], Tensor]) -> None:
        """Apply `column` to every column and `moments` to every row-aligned tensor of the optimizer."""
        for group in self._groups:
            name, old = group["name"], group["params"][0]
            new = nn.Parameter(column(name, old.detach()).contiguous(), requires_grad=old.requires_grad)
            row_state = {key: moments(value).contiguous() for key, value in self._row_state(old).items()}
            state = self._state.pop(old, None)
            if state is not None:
                self._state[new] = {**state, **row_state}
            group["params"][0] = new
            self.learnable[name] = new
        for name, values in list(self.carried.named_buffers()):
            setattr(self.carried, name, column(name, values))

    def _row_state(self, parameter: nn.Parameter) -> dict[str, Tensor]:
        """The row-aligned tensors among a parameter's optimizer state."""
        state = self._state.get(parameter, {})
        return {
            key: value
            for key, value in state.items()
            if isinstance(value, Tensor) and value.dim() and len(value) == len(parameter)
        }

    def _group(self, name: str) -> dict[str, Any]:
        for group in self._groups:
            if group["name"] == name:
                return group
        raise KeyError(f"expected one of the columns {[g['name'] for g in self._groups]}, got {name!r}")


def _adam(groups: list[dict[str, Any]]) -> torch.optim.Optimizer:
    return torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15, fused=True)


def _resize_to_state(rows: nn.Module, state: Mapping[str, Tensor], prefix: str, *_: Any) -> None:
    """Before loading, resize the rows to their number in the state."""
    assert isinstance(rows, Rows)
    saved = next((values for key, values in state.items() if key.startswith(prefix + "learnable.")), None)
    if saved is not None and len(saved) != len(rows):
        rows.take(torch.zeros(len(saved), dtype=torch.int64, device=next(rows.parameters()).device))
