"""The number of steps that an avatar was trained for, which its schedule reads several times a step."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn


class StepCounter(nn.Module):
    """A module whose `state_dict` holds the steps done, on the CPU wherever its parameters are.

    The count decides branches of the host, which would wait for the device each time that it is read there.

    Attributes:
        steps_done: The count, int64.
    """

    steps_done: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("steps_done", torch.zeros((), dtype=torch.int64))

    def _apply(self, fn: Any, recurse: bool = True) -> Any:
        """Move everything but the count, as `to` does."""
        count = self.steps_done
        super()._apply(fn, recurse)
        self.steps_done = count
        return self
