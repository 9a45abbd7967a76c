"""Just-in-time compilation of kernels, cached on disk."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.event import Event, Listener, register

from ggavatar.jit.kernel_cache import KernelCache, cache_folder, source_digest

CACHE = None if os.environ.get("NUMBA_CACHE_DIR") else cache_folder()

OPTIONS = {
    "nogil": True,
    "error_model": "numpy",  # division by zero follows IEEE
    "boundscheck": False,
    "fastmath": {"contract", "nsz", "arcp"},  # contraction to fused multiply-add, but no reordering
}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel on its first call, cached on disk."""
    plain = inspect.unwrap(function)  # tests check types through decorators
    dispatcher = numba.njit(**OPTIONS)(plain)
    if CACHE is not None:  # Numba reads the folder when a cache is made
        numba.config.CACHE_DIR = str(CACHE / source_digest(Path(inspect.getfile(plain))))
    dispatcher._cache = KernelCache(plain)
    return dispatcher


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A helper of kernels, inlined by LLVM; caching it too would only double the work of the first compilation."""
    return numba.njit(inline="never", forceinline=True, **OPTIONS)(inspect.unwrap(function))


_told: set[str] = set()


def announce(what: str) -> None:
    """Say on stderr, once per process, that a first compilation is under way, since it takes seconds."""
    if what not in _told:
        _told.add(what)
        sys.stderr.write(f"compiling {what} for this processor (once; kept in {CACHE or numba.config.CACHE_DIR})\n")


class _Announcer(Listener):
    """Hears of every compilation that the cache could not spare."""

    def on_start(self, event: Event) -> None:
        module = event.data["dispatcher"].py_func.__module__ or ""
        if module.split(".")[0] in ("ggavatar", "preprocess", "evaluate"):
            announce("kernels")

    def on_end(self, event: Event) -> None:
        """Nothing to say."""


register("numba:compile", _Announcer())
