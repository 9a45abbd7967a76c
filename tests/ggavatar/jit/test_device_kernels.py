"""Where Triton kernels run and how they are launched, by the numbers that a small one writes.

Also covers `ggavatar/jit/trial_kernel.py`, `ggavatar/jit/triton_kernels.py`.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from typing import Any

import pytest
import torch

from ggavatar.jit import device_kernels
from tests.support.triton_kernels import interpreted


@pytest.fixture(autouse=True)
def _no_answers_kept() -> Iterator[None]:
    device_kernels.missing.cache_clear()
    yield
    device_kernels.missing.cache_clear()


@interpreted
def test_a_kernel_runs_on_cpu_tensors_when_interpreted() -> None:
    from ggavatar.jit.trial_kernel import count_up

    numbers = torch.full((16,), -1, dtype=torch.int32)
    device_kernels.launch(count_up, 0, numbers, SIZE=16)
    assert numbers.tolist() == [-1] * 16
    device_kernels.launch(count_up, 1, numbers, SIZE=16)
    assert numbers.tolist() == list(range(16))
    assert device_kernels.missing("cpu") == ""


def test_kernels_do_not_run_on_a_cpu_unless_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRITON_INTERPRET", "0")
    assert device_kernels.missing("cpu") == "Triton kernels do not run on cpu"
    assert device_kernels.missing("mps") == "Triton kernels do not run on mps"


def test_what_is_missing_is_said_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_kernels, "importable", lambda module: False)
    assert "comes with torch's CUDA wheels on Linux" in device_kernels.missing("cuda")
    device_kernels.missing.cache_clear()
    monkeypatch.setattr(device_kernels, "importable", lambda module: True)
    old = types.ModuleType("triton")
    old.__version__ = "3.1.0"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "triton", old)
    assert device_kernels.missing("cuda") == "triton 3.1.0 is older than 3.3; pip install torch>=2.7"


@interpreted
def test_ability_is_tried_and_not_inferred(monkeypatch: pytest.MonkeyPatch) -> None:
    """Triton imports where its launcher cannot be compiled; its error is of the C compiler."""
    monkeypatch.setattr(torch, "empty", lambda *_, **__: torch.zeros(16))
    tried: list[int] = []

    def fail(kernel: Any, programs: int, *_: Any, **__: Any) -> None:
        tried.append(programs)
        raise RuntimeError("Failed to find C compiler. Please specify via CC\nmore lines")

    monkeypatch.setattr(device_kernels, "launch", fail)
    message = device_kernels.missing("cuda")
    assert message.startswith(
        "triton cannot run a kernel here (Failed to find C compiler. Please specify via CC); it needs"
    )
    assert device_kernels.missing("cuda") == message and tried == [1]
    device_kernels.missing.cache_clear()
    monkeypatch.setattr(device_kernels, "launch", lambda *_, **__: None)
    assert device_kernels.missing("cuda") == ""
