"""Decorators for kernels in Triton, and for the functions that they call."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import triton

NUMBERS = ("rows", "capacity", "width", "height", "tiles_x", "tiles", "steps", "programs")
"""Names of numbers among kernels' parameters.

Triton compiles a variant of a kernel for every kind of value of other numbers: 1, multiples of 16, the rest.
"""


def device_function(function: Callable[..., Any]) -> Any:
    """A function that kernels call; the tests wrap functions to check types, which Triton cannot read."""
    return triton.jit(inspect.unwrap(function))


def device_kernel(function: Callable[..., Any]) -> Any:
    """A kernel, to be launched by `ggavatar.jit.device_kernels.launch`."""
    return triton.jit(inspect.unwrap(function), do_not_specialize=NUMBERS)
