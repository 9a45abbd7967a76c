"""Constants on a device: right values, made once for every dtype, usable in a backward pass."""

from __future__ import annotations

import torch

from ggavatar.jit.constants import constant, constant_like, to_device


def test_values_dtype_and_identity() -> None:
    for dtype in (torch.float32, torch.float64):
        like = torch.zeros(5, dtype=dtype)
        found = constant_like((0.3, -0.2, 0.1), like)
        assert torch.equal(found, torch.tensor([0.3, -0.2, 0.1], dtype=dtype)) and found.dtype is dtype
        assert constant_like((0.3, -0.2, 0.1), like) is found
    assert torch.equal(constant((2, 0), torch.int64, torch.device("cpu")), torch.tensor([2, 0]))


def test_one_made_in_inference_serves_training() -> None:
    with torch.inference_mode():
        constant_like((0.125, 4.0), torch.zeros(1))
    x = torch.ones(2, requires_grad=True)
    (x * x * constant_like((0.125, 4.0), x)).sum().backward()
    assert torch.equal(x.grad, torch.tensor([0.25, 8.0]))


def test_a_cpu_needs_no_pinned_memory() -> None:
    values = torch.arange(3)
    assert to_device(values, torch.device("cpu")) is values
