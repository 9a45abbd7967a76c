"""Matrix products in bfloat16, on processors that compute them in hardware at twice the rate of float32 or more.

Torch compiles such a product for every matrix size and caches a thousand of them, a gigabyte in all: sizes that change
with every step must be rounded up (`padded_indices`).
"""

from __future__ import annotations

import functools

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

CPU_FEATURES = ("avx512bf16", "amx-bf16")
"""LLVM's names of the processor features that provide bfloat16 matrix products."""


def matmul_dtype(device: torch.device) -> torch.dtype:
    """Dtype for layers that need no more than 8 bits of mantissa: bfloat16 on a CPU made for it, else float32."""
    return torch.bfloat16 if device.type == "cpu" and _has_bfloat16_products() else torch.float32


def padded_indices(wanted: Bool[Tensor, " N"], multiple: int) -> Int64[Tensor, " M"]:
    """Indices of the wanted rows, followed by others until M is a multiple of `multiple` or all N rows are taken.

    On a device all rows are taken: to know how many are wanted, the host would have to wait for it.
    """
    if wanted.device.type == "cuda":
        return torch.arange(len(wanted), device=wanted.device)
    count = int(wanted.sum())
    return torch.argsort(~wanted, stable=True)[: -(-count // multiple) * multiple]


@functools.cache
def _has_bfloat16_products() -> bool:
    try:
        from llvmlite.binding import get_host_cpu_features
    except ImportError:
        return False
    try:
        features = get_host_cpu_features()
    except RuntimeError:  # LLVM does not know on every platform
        return False
    return any(features.get(name, False) for name in CPU_FEATURES)
