"""Kernels in Triton: whether they run on a device, and how they are launched.

Triton comes with torch's own CUDA wheels on Linux. With `TRITON_INTERPRET=1` in the environment, before triton is
imported, kernels run interpreted on CPU tensors instead, very slowly; the tests do that.
"""

from __future__ import annotations

import contextlib
import functools
import os
from typing import Any

import torch
from torch import Tensor

from ggavatar.jit.dispatch import importable

LEAST_TRITON = (3, 3)
"""The oldest version whose kernels take tuples; torch 2.7 brings it."""


def interpreted() -> bool:
    """Whether kernels run interpreted, on CPU tensors."""
    return os.environ.get("TRITON_INTERPRET", "0") not in {"", "0"}


def launch(kernel: Any, programs: int, *arguments: Any, warps: int = 4, **constants: Any) -> None:
    """Run `programs` programs of a kernel on the device of the first argument; every launch goes through here.

    Args:
        kernel: A function decorated with `triton.jit`.
        programs: Size of the one-dimensional grid; nothing happens for 0.
        *arguments: Tensors and numbers, in the order of the kernel's parameters.
        warps: Groups of 32 threads a program.
        **constants: The kernel's `tl.constexpr` parameters.
    """
    if programs > 0:
        with _on_device_of(arguments[0]):
            kernel[(programs,)](*arguments, **constants, num_warps=warps)


def _on_device_of(tensor: Tensor) -> contextlib.AbstractContextManager[Any]:
    """Make the device of a tensor the current one, where Triton launches."""
    if tensor.device.type == "cuda" and torch.cuda.device_count() > 1:
        return torch.cuda.device(tensor.device)
    return contextlib.nullcontext()


def run_on(*tensors: Tensor) -> bool:
    """Whether kernels take these tensors: float32 (or integers) on a CUDA device where they run."""
    if not all(tensor.device.type == "cuda" for tensor in tensors):
        return False
    supported = all(tensor.dtype is torch.float32 or not tensor.dtype.is_floating_point for tensor in tensors)
    return supported and not missing("cuda")


def is_capturing() -> bool:
    """Whether a CUDA graph is being captured, when nothing may be asked of the device."""
    return torch.cuda.is_current_stream_capturing()


def event_now() -> Any:
    """An event that happens when the current CUDA device has done what was launched so far; see its `query()`."""
    event = torch.cuda.Event()
    event.record()
    return event


@functools.cache
def missing(kind: str) -> str:
    """What keeps kernels from running on devices of a kind, with a remedy; empty if they run.

    On CUDA a small kernel is compiled and run, because that also needs a C compiler for the launcher.
    """
    if kind != "cuda" and not (kind == "cpu" and interpreted()):
        return f"Triton kernels do not run on {kind}"
    if not importable("triton"):
        return "triton cannot be imported; it comes with torch's CUDA wheels on Linux"
    import triton

    version = tuple(int(part) for part in triton.__version__.split(".")[:2])
    if version < LEAST_TRITON:
        return f"triton {triton.__version__} is older than {LEAST_TRITON[0]}.{LEAST_TRITON[1]}; pip install torch>=2.7"
    return "" if kind == "cpu" else _trial()


def _trial() -> str:
    """What a small kernel on the current CUDA device fails with; empty if it runs."""
    from ggavatar.jit.trial_kernel import count_up

    try:
        numbers = torch.empty(16, dtype=torch.int32, device="cuda")
        launch(count_up, 1, numbers, SIZE=16)
    except Exception as error:  # Triton, the C compiler and the driver each raise errors of their own
        first = (str(error).strip() or repr(error)).splitlines()[0]
        return f"triton cannot run a kernel here ({first}); it needs a C compiler such as gcc, and Python's headers"
    return ""
