"""Tensors whose memory is padded to whole groups of sixteen rows, as compiled kernels write them, and flat views."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def flat(tensor: Tensor) -> np.ndarray:
    """A contiguous tensor's memory as a flat array, without gradient."""
    return tensor.detach().view(-1).numpy()


def padded(count: int, *columns: int) -> Tensor:
    """An uninitialized float32 tensor of `count` rows, in memory for a multiple of sixteen rows."""
    return torch.empty(-(-count // 16) * 16, *columns)[:count]


def memory_of(tensor: Tensor) -> np.ndarray:
    """The memory of a tensor created by `padded`, padding included, as a flat array."""
    return flat(tensor if tensor._base is None else tensor._base)
