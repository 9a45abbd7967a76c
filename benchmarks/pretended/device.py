"""`pretended_cuda`: torch as on a computer with a CUDA device, which counts and computes on the CPU."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any
from unittest import mock

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from benchmarks.pretended.kernels import counted_kernels
from benchmarks.pretended.rasterizers import stand_ins
from benchmarks.pretended.tally import Tally
from benchmarks.pretended.tensors import PretendedTensor, note_transfer
from ggavatar.jit.constants import constant

COPIED_IN = ("tensor", "as_tensor", "asarray", "scalar_tensor")
"""Functions that copy values of the host to the device, and wait for it."""


@contextlib.contextmanager
def pretended_cuda(with_kernels: bool = False) -> Iterator[Tally]:
    """While active, the device `cuda` exists; yields what it counts.

    Not pretended: streams, races, memory and speed.

    Args:
        with_kernels: Count what is launched on a GPU where Triton works, with our kernels writing nothing
            (`kernels.py`); else compute right values, with rasterizers that are stand-ins (`rasterizers.py`) and the
            torch twins of the other kernels.
    """
    tally = Tally()
    functions = {
        "_lazy_init": lambda: None,
        "is_available": lambda: True,
        "current_device": lambda: 0,
        "device_count": lambda: 1,
        "get_device_name": lambda *_: "pretended",
        "max_memory_allocated": lambda *_: 0,
        "mem_get_info": lambda *_: (8 << 30, 8 << 30),
        "synchronize": lambda *_: tally.wait("synchronize"),
    }
    with contextlib.ExitStack() as stack:
        for name, function in functions.items():
            stack.enter_context(mock.patch.object(torch.cuda, name, function))
        stack.enter_context(mock.patch.object(Tensor, "pin_memory", _pinned))
        stack.enter_context(counted_kernels() if with_kernels else stand_ins())
        stack.enter_context(mock.patch.object(torch.autograd, "_engine_run_backward", _backward_with(tally)))
        stack.enter_context(PretendedFunctions(tally))
        constant.cache_clear()
        yield tally
        constant.cache_clear()


def _backward_with(tally: Tally) -> Any:
    """The backward pass, whose Python code sees the device too."""
    run = torch.autograd._engine_run_backward

    def run_with_device(*args: Any, **kwargs: Any) -> Any:
        with PretendedFunctions(tally):
            return run(*args, **kwargs)

    return run_with_device


def _pinned(tensor: Tensor, *_: Any) -> Tensor:
    kept = tensor.clone()
    kept.pretended_pinned = True  # type: ignore[attr-defined]
    return kept


class PretendedFunctions(TorchFunctionMode):
    """Makes tensors on the pretended device, and moves them to and from it."""

    def __init__(self, tally: Tally) -> None:
        super().__init__()
        self.tally = tally

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run a function of torch."""
        kwargs = dict(kwargs or {})
        name = getattr(func, "__name__", "")
        if func in (Tensor.to, Tensor.cuda, Tensor.cpu):
            return self._moved(*_destination(func, args, kwargs))
        if func == Tensor.grad.__get__ and isinstance(args[0], PretendedTensor):  # type: ignore[union-attr]
            return self._wrapped(func(*args, **kwargs))
        if name in ("__matmul__", "matmul", "__rmatmul__") and args[0].dim() == 1 and args[1].dim() == 2:
            return func(args[0][None], args[1])[0]  # a wrapper does not see squeeze_ within C++
        if func is Tensor.new_tensor and isinstance(args[0], PretendedTensor):
            kwargs["device"], kwargs["dtype"] = "cuda", kwargs.get("dtype") or args[0].dtype
            func, args, name = torch.tensor, args[1:], "tensor"
        return self._made(func, name, args, kwargs) if _is_cuda(kwargs.get("device")) else func(*args, **kwargs)

    def _made(self, func: Any, name: str, args: Any, kwargs: dict[str, Any]) -> Any:
        """What a factory makes on the device."""
        if kwargs.get("generator") is not None:
            raise RuntimeError("expected a 'cuda' generator, found 'cpu'")
        with torch._C.DisableTorchFunction():
            found = func(*args, **{**kwargs, "device": "cpu"})
            if name == "empty":
                found.detach().zero_()  # what a kernel that is only counted would write
        self.tally.launch(name)
        if name in COPIED_IN and not isinstance(args[0], PretendedTensor):
            self.tally.wait(f"{name}(device=cuda)")
        return self._wrapped(found)

    def _moved(self, tensor: Tensor, device: Any, dtype: torch.dtype | None, non_blocking: bool) -> Tensor:
        """`tensor` on another device or in another dtype; gradients do not follow it from device to device."""
        is_here = isinstance(tensor, PretendedTensor)
        if device is None or _is_cuda(device) == is_here:
            if dtype is None or dtype == tensor.dtype:
                return tensor
            return torch.ops.aten._to_copy.default(tensor, dtype=dtype)
        note_transfer(self.tally, tensor, non_blocking)
        values = (tensor.inner if isinstance(tensor, PretendedTensor) else tensor).detach()
        values = values.clone() if dtype in (None, tensor.dtype) else values.to(dtype)
        return values if is_here else PretendedTensor(values, self.tally)

    def _wrapped(self, value: Any) -> Any:
        is_plain = isinstance(value, Tensor) and not isinstance(value, PretendedTensor)
        return PretendedTensor(value, self.tally) if is_plain else value


def _destination(func: Any, args: Any, kwargs: dict[str, Any]) -> tuple[Tensor, Any, torch.dtype | None, bool]:
    """Tensor, device, dtype and `non_blocking` of a call of `to`, `cuda` or `cpu`."""
    device, dtype, non_blocking = kwargs.get("device"), kwargs.get("dtype"), kwargs.get("non_blocking", False)
    if func is Tensor.to:
        for value in args[1:]:
            if isinstance(value, Tensor):
                device, dtype = value.device, value.dtype
            elif isinstance(value, torch.dtype):
                dtype = value
            elif isinstance(value, bool):
                non_blocking = value
            elif value is not None:
                device = value
    else:
        device = "cuda" if func is Tensor.cuda else "cpu"
    if _is_fused_adam() and isinstance(args[0], PretendedTensor):
        device = None  # torch groups parameters by the device that C++ sees, which is the CPU here
    return args[0], device, dtype, non_blocking


def _is_fused_adam() -> bool:
    import sys

    frame = sys._getframe(3)
    return frame.f_code.co_name == "_fused_adam"


def _is_cuda(device: Any) -> bool:
    return device is not None and not isinstance(device, int) and torch.device(device).type == "cuda"
