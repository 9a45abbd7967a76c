"""When tests of Triton kernels run: interpreted on CPU tensors."""

from __future__ import annotations

import importlib.util
import os

import pytest

interpreted = pytest.mark.skipif(
    importlib.util.find_spec("triton") is None or os.environ.get("TRITON_INTERPRET") != "1",
    reason="Triton's interpreter: triton is on Linux only, and where there is a GPU it needs TRITON_INTERPRET=1",
)
"""Marks tests that run kernels in Triton's interpreter."""
