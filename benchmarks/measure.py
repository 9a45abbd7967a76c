"""Timing on a shared machine: interleaved candidates, medians, CPU and wall time, and a record of the environment."""

from __future__ import annotations

import gc
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import torch

from ggavatar.io.ordered_map import cores


@dataclass(frozen=True)
class Timing:
    """Milliseconds per call: medians, interquartile ranges and minima."""

    cpu_ms: float
    cpu_iqr_ms: float
    wall_ms: float
    wall_iqr_ms: float
    least_cpu_ms: float
    least_wall_ms: float
    rounds: int

    def as_dict(self) -> dict[str, float]:
        """Values for JSON, rounded to the resolution of the clock."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


def interleaved(candidates: dict[str, Callable[[], object]], rounds: int, warm_up: int = 1) -> dict[str, Timing]:
    """Time the candidates in the order A B C A B C …, so that changes in machine load affect all of them.

    Every turn is an untimed and a timed call, so that none pays for the heap left by its predecessor.
    """
    samples: dict[str, list[tuple[float, float]]] = {name: [] for name in candidates}
    for number in range(warm_up + rounds):
        for name, call in candidates.items():
            gc.collect()
            call()
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            sample = time.process_time() - cpu, time.perf_counter() - wall
            if number >= warm_up:
                samples[name].append(sample)
    return {name: _summary(np.array(values) * 1e3) for name, values in samples.items()}


def _summary(samples: np.ndarray) -> Timing:
    low, middle, high = np.percentile(samples, (25, 50, 75), axis=0)
    spread, least = high - low, samples.min(0)
    return Timing(middle[0], spread[0], middle[1], spread[1], least[0], least[1], len(samples))


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch and our kernels use `count` threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def peak_extra_megabytes(call: Callable[[], object]) -> float | None:
    """Increase of peak resident memory during a call, MiB; None if the system does not report it."""
    clear = Path("/proc/self/clear_refs")
    if not clear.exists():
        return None
    gc.collect()
    clear.write_text("5")  # resets the peak
    before = _status("VmRSS")
    result = call()
    del result
    return round((_status("VmHWM") - before) / 1024, 1)


def _status(field: str) -> float:
    """A field of /proc/self/status in KiB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return float(line.split()[1])
    raise RuntimeError(f"/proc/self/status has no {field}")


def environment() -> dict[str, object]:
    """Processor, instruction set, cores, load and versions."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": _processor(),
        "instruction_set": _instruction_set(),
        "cores": cores(),
        "load_average": [round(value, 2) for value in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "date": time.strftime("%Y-%m-%d"),
        "versions": {name: _version(name) for name in ("torch", "numba", "llvmlite", "numpy", "ggavatar")},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


def _processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()


def _instruction_set() -> str:
    """The widest vector instructions the kernels are compiled for; $NUMBA_CPU_NAME restricts them."""
    from llvmlite import binding

    if os.environ.get("NUMBA_CPU_NAME"):
        return f"NUMBA_CPU_NAME={os.environ['NUMBA_CPU_NAME']}"
    features = binding.get_host_cpu_features()
    return next((name for name in ("avx512f", "avx2", "neon", "sse2") if features.get(name)), "unknown")
