"""Tensors that say they are on a CUDA device and are computed on the CPU.

Their `device` is cuda:0 in Python, and every operation of torch reaches `PretendedTensor.__torch_dispatch__`, which
refuses to mix devices as CUDA does, and counts launches and synchronizations in the tensor's `Tally`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import torch
from torch import Tensor
from torch.utils._pytree import tree_leaves, tree_map

from benchmarks.pretended.tally import WAITING, Tally, is_backward, is_in_formula, place

CUDA = torch.device("cuda:0")
INDEXING = ("index", "index_put", "index_put_", "_index_put_impl_")


class PretendedTensor(Tensor):
    """A tensor around one on the CPU.

    Attributes:
        inner: The values.
        tally: Where its operations are counted.
    """

    inner: Tensor  # type: ignore[assignment]
    tally: Tally
    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment]

    @staticmethod
    def __new__(cls, inner: Tensor, tally: Tally) -> PretendedTensor:
        """Wrap `inner`; its autograd history does not come along."""
        made = Tensor._make_wrapper_subclass(
            cls,
            inner.size(),
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            layout=inner.layout,
            device=inner.device,
            requires_grad=inner.requires_grad,
        )
        made.inner, made.tally = inner, tally
        return made

    device = property(lambda self: CUDA)
    is_cuda = property(lambda self: True)
    is_cpu = property(lambda self: False)

    def tolist(self) -> Any:
        """The values, for which the host waits."""
        self.tally.wait("tolist")
        return self.inner.tolist()

    def __repr__(self, *_: Any, **__: Any) -> str:  # type: ignore[override]
        return f"PretendedTensor({tuple(self.shape)}, {self.dtype})"

    def __tensor_flatten__(self) -> tuple[list[str], Tally]:
        return ["inner"], self.tally

    @staticmethod
    def __tensor_unflatten__(parts: dict[str, Tensor], tally: Tally, *_: Any) -> PretendedTensor:
        return PretendedTensor(parts["inner"], tally)

    def numpy(self, *_: Any, **__: Any) -> NoReturn:
        """Refuse, as for a tensor on CUDA."""
        raise TypeError(f"can't convert cuda:0 device type tensor to numpy ({place()})")

    __array__ = numpy

    @classmethod
    def __torch_dispatch__(  # type: ignore[override]
        cls, func: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        """Run an operation on the CPU and count it."""
        return _dispatch(func, args, kwargs or {})


def inner(value: Any) -> Any:
    """The CPU tensor within, or the value itself."""
    return value.inner if isinstance(value, PretendedTensor) else value


def _dispatch(func: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    name = func.overloadpacket.__name__
    ours = [value for value in tree_leaves((args, kwargs)) if isinstance(value, PretendedTensor)]
    tally = ours[0].tally
    if name == "copy_":
        return _copy(tally, *args, **kwargs)
    if name == "_to_copy":
        return _convert(tally, args[0], kwargs)
    if name == "_local_scalar_dense":
        tally.wait("item")
        return func(inner(args[0]))
    if name in WAITING:
        tally.wait(name)
    if name == "repeat_interleave" and isinstance(args[0], PretendedTensor) and kwargs.get("output_size") is None:
        tally.wait(name)
    _check_devices(name, args, kwargs, tally)
    found = func(*tree_map(inner, args), **_on_the_cpu(kwargs))
    if "empty" in name:
        found.detach().zero_()  # what a kernel that is only counted would write
    tally.launch(name)
    return _wrapped(found, ours, tally, func._schema.is_mutable)


def _wrapped(found: Any, ours: list[PretendedTensor], tally: Tally, mutable: bool) -> Any:
    """Results as pretended tensors; those that are an argument, as of operations in place, as that argument."""
    known = {id(value.inner): value for value in ours} if mutable else {}

    def wrap(value: Any) -> Any:
        if not isinstance(value, Tensor) or isinstance(value, PretendedTensor):
            return value
        return known.get(id(value)) if id(value) in known else PretendedTensor(value, tally)

    return tree_map(wrap, found)


def _on_the_cpu(kwargs: dict[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {name: tree_map(inner, value) for name, value in kwargs.items()}
    if values.get("device") is not None:
        values["device"] = torch.device("cpu")
    if values.get("generator") is not None:
        raise RuntimeError(f"expected a 'cuda' generator, found 'cpu' ({place()})")
    return values


def _check_devices(name: str, args: Sequence[Any], kwargs: dict[str, Any], tally: Tally) -> None:
    """Refuse tensors on the CPU beside ours, except numbers, and indices, which are copied over."""
    others = [v for v in tree_leaves((args, kwargs)) if isinstance(v, Tensor) and not isinstance(v, PretendedTensor)]
    if name in INDEXING and isinstance(args[0], PretendedTensor):
        indices = [value for value in args[1] if value is not None]
        if any(not isinstance(value, PretendedTensor) for value in indices):
            tally.wait("index copied to the device")
        if any(value.dtype in (torch.bool, torch.uint8) for value in indices):
            tally.wait("boolean mask")
        others = [value for value in others if not any(value is index for index in indices)]
    wrong = [value for value in others if value.dim() > 0]
    if wrong and is_backward():
        wrong = [value for value in wrong if value.any()]  # autograd's zeros in place of a missing gradient
    if wrong and not is_in_formula():
        raise RuntimeError(
            f"expected all tensors to be on the same device, found cuda:0 and cpu in {name} "
            f"(shapes {[tuple(value.shape) for value in wrong]}) at {place()}"
        )


def _copy(tally: Tally, target: Tensor, source: Tensor, non_blocking: bool = False) -> Tensor:
    inner(target).copy_(inner(source))
    if isinstance(target, PretendedTensor) == isinstance(source, PretendedTensor):
        tally.launch("copy_")
    else:
        note_transfer(tally, source, non_blocking)
    return target


def _convert(tally: Tally, source: Tensor, kwargs: dict[str, Any]) -> PretendedTensor:
    """Another dtype or layout; other devices are handled where `Tensor.to` is called (`device.py`)."""
    wanted = {name: value for name, value in kwargs.items() if name not in ("device", "non_blocking", "pin_memory")}
    tally.launch("_to_copy")
    return PretendedTensor(torch.ops.aten._to_copy.default(inner(source), **wanted), tally)


def note_transfer(tally: Tally, source: Tensor, non_blocking: bool) -> None:
    """Count a copy between host and device, for which the host waits unless it need not.

    It need not if it asked so and the memory of the host is pinned; torch itself pins what it copies to the host so.
    """
    to_host = isinstance(source, PretendedTensor)
    tally.launch("copy to the host" if to_host else "copy to the device")
    if not (non_blocking and (to_host or is_pinned(source))):
        tally.wait("copy to the host" if to_host else "copy to the device")


def is_pinned(tensor: Tensor) -> bool:
    """Whether a CPU tensor is in memory that was pinned on the pretended device."""
    return bool(getattr(tensor, "pretended_pinned", False))
