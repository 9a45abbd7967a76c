"""What a process that trains or renders says to the system first: idle threads sleep, freed memory stays at hand."""

from __future__ import annotations

import ctypes
import os

KEPT_BLOCK, KEPT_HEAP = 1 << 25, 1 << 29
"""Blocks up to 32 MiB come from the heap, and up to 512 MiB of it stay with the process when they are freed."""


def prepare_process() -> None:
    """Call before torch is imported; what the user has set in the environment stays."""
    # Idle OpenMP threads would spin on the cores our own threads work on.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _keep_freed_memory()


def _keep_freed_memory() -> None:
    """Otherwise every step gives tens of megabytes back and pays thousands of page faults to get them again."""
    trim_threshold, mmap_threshold = -1, -3  # malloc.h of glibc; other libraries have no mallopt
    try:
        tune = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    tune(trim_threshold, KEPT_HEAP)
    tune(mmap_threshold, KEPT_BLOCK)
