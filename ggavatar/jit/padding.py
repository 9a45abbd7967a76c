"""Tensors with room for whole groups of sixteen rows, as compiled kernels write them, and flat views of memory."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def flat(tensor: Tensor) -> np.ndarray:
    """The memory of a contiguous tensor as a flat array."""
    return tensor.detach().view(-1).numpy()


def padded(count: int, *columns: int) -> Tensor:
    """An uninitialized tensor of `count` rows in memory for a multiple of sixteen."""
    return torch.empty(-(-count // 16) * 16, *columns)[:count]


def memory_of(tensor: Tensor) -> np.ndarray:
    """All the memory behind a tensor made by `padded`, as a flat array."""
    return flat(tensor if tensor._base is None else tensor._base)
