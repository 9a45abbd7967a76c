"""Building a stored avatar within the memory that its own tensors justify: sizes in a file are not to be trusted.

A method makes its avatar in the shape that the settings say, and only then takes over the stored tensors. Settings are
numbers that anybody can change, so that a `hidden` of a million would fill the memory before the shapes are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

T = TypeVar("T")
SHARE, FREE_BYTES = 16, 512 << 20
"""What building may allocate in all while it works: so many times the stored tensors, and so many bytes besides."""
BYTES_PER_OPERATION = 2048
"""Counted besides the values of a tensor: objects around it take memory too, however small it is."""
LARGE = 256
"""An extent from which on a result is worked out without values first; also the square root of a number of values."""


class BuildTooLargeError(RuntimeError):
    """The settings ask for more than the stored tensors justify."""


class BuildBudget(TorchDispatchMode):
    """While it is entered, tensors are made until a number of bytes is reached; what is too large is not made at all.

    Args:
        limit: Bytes.
    """

    def __init__(self, limit: int) -> None:
        super().__init__()
        self._limit, self._left = limit, limit

    def __torch_dispatch__(
        self, func: Any, types: Sequence[type], args: tuple[Any, ...] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        """Run an operation if its result fits."""
        named = dict(kwargs or {})
        if _may_be_large(args, named):
            self._check(_expected_bytes(func, args, named))
        result = func(*args, **named)
        known = {value.untyped_storage().data_ptr() for value in _tensors(args)}
        fresh = [value for value in _tensors((result,)) if value.untyped_storage().data_ptr() not in known]
        self._check(_bytes(fresh) + BYTES_PER_OPERATION)
        self._left -= _bytes(fresh) + BYTES_PER_OPERATION
        return result

    def _check(self, count: int) -> None:
        if count > self._left:
            raise BuildTooLargeError(
                f"settings that ask for more than the {self._limit >> 20} MiB that suit its tensors"
            )


def within_budget(stored: Iterable[Tensor], build: Callable[[], T]) -> T:
    """What `build` returns.

    Args:
        stored: The tensors that the result is compared with afterwards.
        build: Makes it.

    Raises:
        BuildTooLargeError: It asks for more memory than these tensors justify.
    """
    size = sum(value.untyped_storage().nbytes() for value in stored)
    with BuildBudget(FREE_BYTES + SHARE * size):
        return build()


def _tensors(values: Any) -> list[Tensor]:
    """The tensors in arguments or results."""
    return [value for value in pytree.tree_leaves(values) if isinstance(value, Tensor)]


def _bytes(tensors: Iterable[Tensor]) -> int:
    return sum(value.untyped_storage().nbytes() for value in tensors)


def _may_be_large(args: Sequence[Any], named: Mapping[str, Any]) -> bool:
    """Whether arguments hold an extent or a tensor from which a large result can come."""
    leaves = pytree.tree_leaves((args, named))
    return any(
        value.numel() > LARGE**2 if isinstance(value, Tensor) else isinstance(value, int | float) and value > LARGE
        for value in leaves
    )


def _expected_bytes(func: Any, args: Sequence[Any], named: Mapping[str, Any]) -> int:
    """Bytes of the new tensors that an operation will make, worked out without values; 0 if they decide it."""
    if func._schema.is_mutable:
        return 0

    def without_values(value: Any) -> Any:
        return value.to("meta") if isinstance(value, Tensor) else value

    given = {name: None if name == "generator" else value for name, value in named.items()}
    if any(argument.name == "device" for argument in func._schema.arguments):
        given["device"] = torch.device("meta")
    inputs = pytree.tree_map(without_values, tuple(args))
    try:
        result = func(*inputs, **pytree.tree_map(without_values, given))
    except (NotImplementedError, RuntimeError, TypeError):  # the values decide the shape, which the inputs bound
        return 0
    places = {value.untyped_storage()._cdata for value in _tensors(inputs)}
    return _bytes(value for value in _tensors((result,)) if value.untyped_storage()._cdata not in places)
