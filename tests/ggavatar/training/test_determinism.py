"""No operation of a training step adds floats in an order that the threads decide.

Reference: torch's list of nondeterministic operations. On a CPU `index_put_` with accumulation (the gradient of
`values[indices]`) adds from several threads with atomics once it is large enough; the toy is too small to show it, so
the operations themselves are looked for.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from ggavatar.data.capture import Capture
from ggavatar.training import registry
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import StopSignals

METHODS = [name for name in registry.names() if "_without_" not in name]


class AccumulationLog(TorchDispatchMode):
    """Names and shapes of all `index_put` calls that add several floats to one element."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Note the call and let it pass."""
        name = func.overloadpacket.__name__
        accumulates = "index_put" in name and (kwargs or {}).get("accumulate", len(args) > 3 and args[3])
        if accumulates and args[0].is_floating_point() and _repeats(args[1]):
            self.found.add(f"{name} into {tuple(args[0].shape)} from {tuple(args[2].shape)}")
        return func(*args, **(kwargs or {}))


def _repeats(indices: list[torch.Tensor | None]) -> bool:
    """Whether some element is indexed more than once (indices of one axis, as all of ours)."""
    (index,) = [index for index in indices if index is not None]
    return index.unique().numel() < index.numel()


@pytest.mark.parametrize("method", METHODS)
def test_no_step_accumulates_from_several_threads(method: str, toy_capture: Capture, tmp_path: Path) -> None:
    options = {"method": method, "steps": 24, "eval_every": 0, "max_gaussians": 400, "device": "cpu"}
    config, split = configure(toy_capture, options)
    trainer = make_trainer(tmp_path, config, toy_capture, split)
    with AccumulationLog() as log, StopSignals() as stop:
        trainer.run(0, stop)
    assert not log.found


def test_the_log_notices_an_accumulating_gradient() -> None:
    values = torch.zeros(4, 3, requires_grad=True)
    with AccumulationLog() as log:
        values[torch.tensor([[0, 1], [1, 2]])].sum().backward()
    assert log.found
