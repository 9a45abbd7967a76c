"""Provenance of a run (provenance.json): versions, command line, digests, device and outcome."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
import sys
from datetime import UTC, datetime
from typing import Any

import torch

from ggavatar.data.capture import Capture
from ggavatar.data.splits import Split
from ggavatar.training import registry
from ggavatar.training.progress import peak_memory_mib
from ggavatar.training.run_folder import RunConfig
from ggavatar.training.trainer import Trainer

RECORDED_PACKAGES = ("ggavatar", "torch", "numpy", "numba", "triton", "gsplat", "safetensors")
"""Packages whose versions are recorded."""


def provenance_of(config: RunConfig, capture: Capture, split: Split) -> dict[str, Any]:
    """What is known before the first step: versions, command line, device, and digests of the inputs."""
    lists = json.dumps([list(split.train), list(split.test)]).encode()
    on_cuda = config.device.startswith("cuda")
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "argv": sys.argv,
        "versions": {"python": platform.python_version(), **_versions()},
        "platform": platform.platform(),
        "device": config.device,
        "device_name": torch.cuda.get_device_name(config.device) if on_cuda else platform.machine(),
        "threads": torch.get_num_threads(),
        "seed": config.seed,
        "capture_sha256": capture.digest(),
        "split_sha256": hashlib.sha256(lists).hexdigest(),
        **method_package_of(config.method),
        "finished": False,
    }


def method_package_of(method: str) -> dict[str, Any]:
    """The package that brings a method, as an entry of provenance.json; none for a method of our own."""
    plugin = registry.load(method).plugin
    return {} if plugin is None else {"method_package": {"name": plugin.package, "version": plugin.version}}


def outcome_of(trainer: Trainer, done: int) -> dict[str, Any]:
    """What is known after the last step: steps, time, peak memory, and the notes of the method."""
    device = trainer.background.device
    on_gpu = torch.cuda.max_memory_allocated(device) >> 20 if device.type == "cuda" else None
    notes = trainer.avatar.notes() if hasattr(trainer.avatar, "notes") else {}
    return {
        "finished": done >= trainer.plan.steps,
        "steps": done,
        "training_seconds": round(trainer.seconds, 3),
        "peak_memory_mib": peak_memory_mib(),
        "peak_gpu_memory_mib": on_gpu,
        "notes": notes,
    }


def _versions() -> dict[str, str]:
    found = {}
    for name in RECORDED_PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
