"""The smallest kernel in Triton, compiled and run to see whether others will be."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def count_up(numbers, SIZE: tl.constexpr):
    """Write 0, 1, 2, …"""
    index = tl.arange(0, SIZE)
    tl.store(numbers + index, index)
