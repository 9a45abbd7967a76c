"""The smallest kernel in Triton, compiled and run to see whether others will be."""

from __future__ import annotations

import triton.language as tl

from ggavatar.jit.triton_kernels import device_kernel


@device_kernel
def count_up(numbers, SIZE: tl.constexpr):
    """Write the numbers from 0 on."""
    index = tl.arange(0, SIZE)
    tl.store(numbers + index, index)
