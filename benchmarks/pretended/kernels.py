"""Our own kernels on a pretended device: counted, not run, so that what they would write stays zero."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any
from unittest import mock

from benchmarks.pretended.tensors import PretendedTensor
from ggavatar.jit import device_kernels


@contextlib.contextmanager
def counted_kernels() -> Iterator[None]:
    """While active, kernels in Triton are taken as on a GPU where they run, and each launch of one is counted.

    Steps and renderings take the way that they take on a GPU, with pictures and gradients of zeros.
    """
    replaced = {"launch": _count, "missing": lambda _: "", "is_capturing": lambda: False, "event_now": _PastEvent}
    with contextlib.ExitStack() as stack:
        for name, function in replaced.items():
            stack.enter_context(mock.patch.object(device_kernels, name, function))
        yield


class _PastEvent:
    """An event that has happened."""

    def query(self) -> bool:
        return True


def _count(kernel: Any, programs: int, *arguments: Any, warps: int = 4, **constants: Any) -> None:
    """Count a launch, as `device_kernels.launch` would make it."""
    if programs > 0:
        tensors = [value for value in arguments if isinstance(value, PretendedTensor)]
        if not tensors:
            raise RuntimeError(f"{kernel.fn.__name__}: expected tensors on cuda:0")
        tensors[0].tally.launch(f"kernel {kernel.fn.__name__}")
