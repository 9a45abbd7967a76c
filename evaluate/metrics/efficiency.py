"""What an avatar costs: rendering time, model size, peak memory."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ggavatar.core import Avatar, Camera, Drive, Gaussians, Rasterizer, Rendering


@torch.no_grad()
def timed_render(
    avatar: Avatar, rasterize: Rasterizer, view: tuple[Drive, Camera], background: Sequence[float]
) -> tuple[Rendering, Gaussians, float]:
    """Render one view without gradients; return the rendering, the Gaussians and the seconds from drive to image."""
    drive, camera = view
    color = camera.intrinsics.new_tensor(background)
    _synchronize(color.device)
    start = time.perf_counter()
    gaussians = avatar.gaussians(drive)
    rendering = rasterize(gaussians, camera, color)
    _synchronize(color.device)
    return rendering, gaussians, time.perf_counter() - start


def _synchronize(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def timing(seconds: Sequence[float], device: torch.device) -> dict[str, Any]:
    """Frames per second (1 / median frame time), with a statement of what the time includes.

    Args:
        seconds: Time of every frame except the first, which warms up.
        device: Device of the avatar.
    """
    return {
        "fps": 1.0 / statistics.median(seconds),
        "seconds_median": statistics.median(seconds),
        "seconds_mean": statistics.fmean(seconds),
        "frames": len(seconds),
        "includes": "head model, deformation networks and rasterization of one frame at a time, device synchronized",
        "excludes": "reading, copying to the host, PNG encoding, the first frame",
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else device.type,
        "threads": torch.get_num_threads(),
    }


def model_megabytes(avatar: torch.nn.Module) -> float:
    """Size of all weights and buffers, 10⁶ bytes: what must be stored to render the avatar."""
    tensors = [value for value in avatar.state_dict().values() if isinstance(value, Tensor)]
    return sum(value.numel() * value.element_size() for value in tensors) / 1e6


def peak_memory_megabytes(device: torch.device) -> dict[str, float]:
    """Peak resident memory of this process (absent on Windows) and, on CUDA, peak allocation, 10⁶ bytes."""
    peaks = {}
    if sys.platform != "win32":
        import resource  # POSIX only

        unit = 1 if sys.platform == "darwin" else 1024
        peaks["host"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    if device.type == "cuda":
        peaks["device"] = torch.cuda.max_memory_allocated(device) / 1e6
    return peaks


def device_of(avatar: torch.nn.Module) -> torch.device:
    """Device of the first weight or buffer; the CPU for an avatar without any."""
    tensors = [*avatar.parameters(), *avatar.buffers()]
    return tensors[0].device if tensors else torch.device("cpu")
