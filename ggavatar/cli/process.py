"""Process-wide settings: OpenMP, malloc, and output streams that cannot fail."""

from __future__ import annotations

import ctypes
import io
import os
import sys

MMAP_THRESHOLD, TRIM_THRESHOLD = 1 << 25, 1 << 29
"""Blocks of up to 32 MiB come from the heap, of which up to 512 MiB stay with the process when they are freed."""


def prepare_process() -> None:
    """Apply the settings; call it before torch is imported. Environment variables that the user has set are kept."""
    # Idle OpenMP threads would otherwise spin on the cores that our own threads use.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _keep_freed_memory()


def prepare_output() -> None:
    """Let no message fail: a closed stdout or stderr swallows it, and an encoding without a character replaces it."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - open until the process ends
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _keep_freed_memory() -> None:
    """Keep freed memory in the process: otherwise every step returns tens of MiB and page-faults them in again."""
    m_trim_threshold, m_mmap_threshold = -1, -3  # malloc.h of glibc; other C libraries have no mallopt
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    mallopt(m_trim_threshold, TRIM_THRESHOLD)
    mallopt(m_mmap_threshold, MMAP_THRESHOLD)
