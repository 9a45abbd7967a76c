"""The choice between a compiled kernel and its torch twin."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys

import torch
from torch import Tensor


def compiled_for(*tensors: Tensor) -> bool:
    """Whether the compiled kernels take these tensors: float32 (or integers) on a CPU where numba can be imported."""
    supported = all(tensor.dtype is torch.float32 or not tensor.dtype.is_floating_point for tensor in tensors)
    return supported and all(tensor.device.type == "cpu" for tensor in tensors) and numba_available()


@functools.cache
def numba_available() -> bool:
    """Whether numba can be imported."""
    return importable("numba")


def importable(module: str) -> bool:
    """Whether `module` imports without an error (an installed package can still be broken)."""
    if module not in sys.modules and importlib.util.find_spec(module) is None:
        return False
    try:
        importlib.import_module(module)
    except (ImportError, OSError):
        return False
    return True
