"""The choice of a rasterizer and a device."""

from __future__ import annotations

import importlib

import torch

from ggavatar.core import Rasterizer
from ggavatar.errors import InputError
from ggavatar.jit.dispatch import importable
from ggavatar.text.terminal import write_err

BACKENDS = {
    "reference": "ggavatar.render.reference",
    "cpu": "ggavatar.render.cpu.rasterizer",
    "gsplat": "ggavatar.render.gsplat",
}
"""Module of every backend, by name."""


def pick(device: torch.device | str, backend: str = "auto") -> Rasterizer:
    """The rasterizer for tensors on `device`.

    Args:
        device: Device of the Gaussians.
        backend: `reference`, `cpu` or `gsplat`; `auto` chooses gsplat on CUDA and the compiled rasterizer on a CPU. If
            that one cannot be imported, it chooses the reference and says on stderr how to install the faster one.

    Raises:
        InputError: The name is unknown, or the named backend cannot run on this device or computer.
    """
    kind = torch.device(device).type
    if backend != "auto":
        return _named(backend, kind)
    wanted = {"cuda": "gsplat", "cpu": "cpu"}.get(kind, "reference")
    missing = _missing(wanted)
    if missing:
        write_err(f"rendering with the reference rasterizer, which is many times slower: {missing}")
    return load("reference" if missing else wanted)


def _missing(backend: str) -> str:
    """What a backend lacks and how to install it; empty if it can run."""
    if backend == "gsplat" and not importable("gsplat"):
        return "gsplat cannot be imported; pip install ggavatar[cuda]"
    if backend == "cpu" and not importable(BACKENDS["cpu"]):
        return "numba cannot be imported; pip install numba"
    return ""


def _named(backend: str, kind: str) -> Rasterizer:
    if backend not in BACKENDS:
        raise InputError(f"expected a rasterizer of auto, {', '.join(BACKENDS)}; found {backend!r}")
    required = {"gsplat": "cuda", "cpu": "cpu"}.get(backend, kind)
    if kind != required:
        raise InputError(f"the {backend} rasterizer needs tensors on a {required} device, found {kind!r}; use auto")
    missing = _missing(backend)
    if missing:
        raise InputError(f"the {backend} rasterizer cannot run: {missing}, or use auto")
    return load(backend)


def load(backend: str) -> Rasterizer:
    """Import a backend's module and return its function `rasterize`."""
    rasterizer: Rasterizer = importlib.import_module(BACKENDS[backend]).rasterize
    return rasterizer


def resolve_device(name: str) -> str:
    """Resolve `auto` to cuda if a CUDA device is available, else to cpu, and check that any other device works.

    Raises:
        InputError: `name` is not a torch device, or torch cannot allocate on it here.
    """
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(f"--device: expected auto, cpu, cuda, cuda:N or mps, found {name!r}") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"--device {name}: torch finds no CUDA device; use cpu or auto")
    if device.type == "meta" or not _allocates(device):
        raise InputError(f"--device {name}: torch cannot allocate on this device here; use cpu or auto")
    return name


def _allocates(device: torch.device) -> bool:
    """Whether a tensor can be made on a device; what torch raises where it cannot is of many kinds."""
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError):
        return False
    return True
