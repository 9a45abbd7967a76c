"""Just-in-time compilation of kernels with numba, cached on disk."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.event import Event, Listener, register

from ggavatar.jit.kernel_cache import PACKAGES, KernelCache, kernel_folder, source_digest

CACHE = kernel_folder()
"""The folder for compiled kernels, which this user alone can write to."""

OPTIONS = {
    "nogil": True,
    "error_model": "numpy",  # division by zero follows IEEE
    "boundscheck": False,
    "fastmath": {"contract", "nsz", "arcp"},  # contraction to fused multiply-add, but no reordering
}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: compile a kernel on its first call and cache it on disk."""
    plain = inspect.unwrap(function)  # the tests wrap functions to check types
    dispatcher = numba.njit(**OPTIONS)(plain)
    folder, others = CACHE / source_digest(Path(inspect.getfile(plain))), numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder)  # numba reads it when the cache is created
    try:
        cache = KernelCache(plain)
    finally:
        numba.config.CACHE_DIR = others
    if cache.is_below(folder):  # numba looks for another place where it cannot write
        dispatcher._cache = cache
    return dispatcher


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: compile a function that LLVM inlines into kernels; caching it too would double the compile time."""
    return numba.njit(inline="never", forceinline=True, **OPTIONS)(inspect.unwrap(function))


_announced: set[str] = set()


def announce(what: str) -> None:
    """Say on stderr, once per process, that a compilation has started, since it takes seconds."""
    if what not in _announced:
        _announced.add(what)
        sys.stderr.write(f"compiling {what} for this processor (once; cached in {CACHE})\n")


class _CompilationListener(Listener):
    """Announces the first compilation of one of our kernels that was not in the cache."""

    def on_start(self, event: Event) -> None:
        module = event.data["dispatcher"].py_func.__module__ or ""
        if module.split(".")[0] in PACKAGES:
            announce("kernels")

    def on_end(self, event: Event) -> None:
        """Required by numba; nothing to do."""


register("numba:compile", _CompilationListener())
