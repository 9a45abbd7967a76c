"""Constants as tensors that stay on a device: making one anew copies it from the host, which waits for the device."""

from __future__ import annotations

import functools

import torch
from torch import Tensor


def constant_like(values: tuple[int | float, ...], like: Tensor) -> Tensor:
    """The values as a tensor of the dtype and on the device of `like`; it is shared, so do not write to it."""
    return constant(values, like.dtype, like.device)


@functools.cache
def constant(values: tuple[int | float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """The values as a tensor, made once for every dtype and device; it is shared, so do not write to it."""
    with torch.inference_mode(False):  # it may be kept for a backward pass later
        return torch.tensor(values, dtype=dtype, device=device)


def to_device(values: Tensor, device: torch.device) -> Tensor:
    """A CPU tensor on a device, copied through pinned memory, so that the host does not wait."""
    if device.type != "cuda":
        return values.to(device)
    return values.pin_memory().to(device, non_blocking=True)
