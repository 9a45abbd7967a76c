"""Where the processor multiplies matrices of bfloat16 in hardware, at twice the rate of float32 and more.

Torch makes machine code for every size of such a product and keeps a thousand of them, a gigabyte in all: sizes that
change with every step are to be rounded.
"""

from __future__ import annotations

import functools

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

HARDWARE = ("avx512bf16", "amx-bf16")
"""Features of a processor that has such instructions, as LLVM names them."""


def product_type(device: torch.device) -> torch.dtype:
    """Type of hidden layers wherever eight bits of mantissa suffice: bfloat16 on a CPU made for it, else float32."""
    return torch.bfloat16 if device.type == "cpu" and _is_made_for_bfloat16() else torch.float32


def in_whole_groups(wanted: Bool[Tensor, " N"], group: int) -> Int64[Tensor, " M"]:
    """Indices of the wanted rows and then of as many others as make M a multiple of `group`, or all N rows."""
    count = int(wanted.sum())
    return torch.argsort(~wanted, stable=True)[: -(-count // group) * group]


@functools.cache
def _is_made_for_bfloat16() -> bool:
    try:
        from llvmlite.binding import get_host_cpu_features
    except ImportError:
        return False
    try:
        features = get_host_cpu_features()
    except RuntimeError:  # LLVM cannot tell on every platform
        return False
    return any(features.get(name, False) for name in HARDWARE)
