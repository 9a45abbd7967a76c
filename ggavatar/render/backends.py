"""Which rasterizer to use on which device."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import sys

import torch

from ggavatar.core import Rasterizer
from ggavatar.errors import InputError

BACKENDS = {
    "reference": "ggavatar.render.reference",
    "cpu": "ggavatar.render.cpu.rasterizer",
    "gsplat": "ggavatar.render.gsplat",
}
"""Modules by the names of the backends."""


def pick(device: torch.device | str, backend: str = "auto") -> Rasterizer:
    """The rasterizer for tensors on `device`.

    Args:
        device: Where the Gaussians live.
        backend: `reference`, `cpu` or `gsplat`; `auto` takes gsplat on CUDA and the compiled rasterizer on a CPU. Where
            that one cannot be imported it takes the reference and says on stderr how to get the faster one.

    Raises:
        InputError: The name is unknown, or the backend asked for by name cannot run here.
    """
    kind = torch.device(device).type
    if backend != "auto":
        return _named(backend, kind)
    wanted = {"cuda": "gsplat", "cpu": "cpu"}.get(kind, "reference")
    missing = _missing(wanted)
    if missing:
        sys.stderr.write(f"drawing with plain torch, which is many times slower: {missing}\n")
    return load("reference" if missing else wanted)


def _missing(backend: str) -> str:
    """What a backend lacks and how to get it; empty if it can run."""
    if backend == "gsplat" and not importable("gsplat"):
        return "gsplat cannot be imported; pip install ggavatar[cuda]"
    if backend == "cpu" and not importable(BACKENDS["cpu"]):
        return "numba cannot be imported; pip install numba"
    return ""


def _named(backend: str, kind: str) -> Rasterizer:
    if backend not in BACKENDS:
        raise InputError(f"expected a rasterizer of auto, {', '.join(BACKENDS)}; found {backend!r}")
    home = {"gsplat": "cuda", "cpu": "cpu"}.get(backend, kind)
    if kind != home:
        raise InputError(f"the {backend} rasterizer needs tensors on a {home} device, found {kind!r}; use auto")
    missing = _missing(backend)
    if missing:
        raise InputError(f"the {backend} rasterizer was asked for, but {missing}")
    return load(backend)


def importable(module: str) -> bool:
    """Whether `module` imports without an error (an installed package can still be broken)."""
    if module not in sys.modules and importlib.util.find_spec(module) is None:
        return False
    try:
        importlib.import_module(module)
    except (ImportError, OSError):
        return False
    return True


def load(backend: str) -> Rasterizer:
    """The function `rasterize` of a backend's module."""
    rasterizer: Rasterizer = importlib.import_module(BACKENDS[backend]).rasterize
    return rasterizer


def resolve_device(name: str) -> str:
    """A device by name; `auto` is CUDA where there is one, else the CPU."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        kind = torch.device(name).type
    except RuntimeError as error:
        raise InputError(f"--device: expected auto, cpu, cuda or cuda:N, found {name!r}") from error
    if kind == "cuda" and not torch.cuda.is_available():
        raise InputError(f"--device {name}: torch sees no CUDA device here; use cpu or auto")
    return name
