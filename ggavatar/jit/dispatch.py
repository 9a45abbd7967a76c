"""Whether a compiled kernel or its torch twin should do the work."""

from __future__ import annotations

import functools
import importlib

import torch
from torch import Tensor


def compiled_for(*tensors: Tensor) -> bool:
    """Whether the compiled kernels take these tensors: float32 (or integers) on a CPU where numba can be imported."""
    kinds = all(tensor.dtype is torch.float32 or not tensor.dtype.is_floating_point for tensor in tensors)
    return kinds and all(tensor.device.type == "cpu" for tensor in tensors) and numba_imports()


@functools.cache
def numba_imports() -> bool:
    """Whether numba can be imported here."""
    try:
        importlib.import_module("numba")
    except (ImportError, OSError):
        return False
    return True
