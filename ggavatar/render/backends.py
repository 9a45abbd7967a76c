"""The choice of a rasterizer and a device."""

from __future__ import annotations

import importlib

import torch

from ggavatar.core import Rasterizer
from ggavatar.errors import InputError
from ggavatar.jit import device_kernels
from ggavatar.jit.dispatch import importable
from ggavatar.text.terminal import write_err

BACKENDS = {
    "reference": "ggavatar.render.reference",
    "cpu": "ggavatar.render.cpu.rasterizer",
    "triton": "ggavatar.render.triton.rasterizer",
    "gsplat": "ggavatar.render.gsplat",
}
"""Module of every backend, by name."""
_REQUIRED = {"triton": "cuda", "gsplat": "cuda", "cpu": "cpu"}
"""The only kind of device that a backend renders on."""


def pick(device: torch.device | str, backend: str = "auto") -> Rasterizer:
    """The rasterizer for tensors on `device`.

    Args:
        device: Device of the Gaussians.
        backend: `reference`, `cpu`, `triton` or `gsplat`; `auto` chooses triton on CUDA, or gsplat where Triton cannot
            run, and the compiled rasterizer on a CPU. If none of them can run, it chooses the reference and says on
            stderr what the faster one lacks.

    Raises:
        InputError: The name is unknown, or the named backend cannot run on this device or computer.
    """
    kind = torch.device(device).type
    if backend != "auto":
        return _named(backend, kind)
    name, lacks = choice(kind)
    if name == "reference" and lacks:
        write_err(f"rendering with the reference rasterizer, which is many times slower: {'; '.join(lacks)}")
    return load(name)


def choice(kind: str) -> tuple[str, list[str]]:
    """The backend that `auto` means on a kind of device, and what the better ones that it passed over lack."""
    lacks: list[str] = []
    for name in {"cuda": ("triton", "gsplat"), "cpu": ("cpu",)}.get(kind, ()):
        if not (lack := _missing(name)):
            return name, lacks
        lacks.append(lack)
    return "reference", lacks


def lacking(backend: str, kind: str) -> str:
    """Why a backend cannot run on a kind of device; empty if it can."""
    required = _REQUIRED.get(backend, kind)
    return _missing(backend) if kind == required else f"needs tensors on a {required} device"


def _missing(backend: str) -> str:
    """What a backend lacks and how to install it; empty if it can run."""
    if backend == "triton":
        return device_kernels.missing("cuda")
    if backend == "gsplat":
        return _missing_for_gsplat()
    if backend == "cpu" and not importable(BACKENDS["cpu"]):
        return "numba cannot be imported; pip install numba"
    return ""


def _missing_for_gsplat() -> str:
    """What gsplat lacks; its wheels hold sources only, which its first use compiles, and it imports without success."""
    if not importable("gsplat"):
        return "gsplat cannot be imported; pip install ggavatar[cuda]"
    try:
        kernels = importlib.import_module("gsplat.cuda._backend")._C
    except Exception as error:  # its build raises errors of torch, ninja, the compiler and the file system
        kernels, reason = None, (str(error).strip() or repr(error)).splitlines()[0]
    else:
        reason = "no CUDA toolkit found"
    return "" if kernels is not None else f"gsplat cannot build its kernels ({reason}); install nvcc, g++ and ninja"


def _named(backend: str, kind: str) -> Rasterizer:
    if backend not in BACKENDS:
        raise InputError(f"expected a rasterizer of auto, {', '.join(BACKENDS)}; found {backend!r}")
    required = _REQUIRED.get(backend, kind)
    if kind != required:
        raise InputError(f"the {backend} rasterizer needs tensors on a {required} device, found {kind!r}; use auto")
    missing = _missing(backend)
    if missing:
        raise InputError(f"the {backend} rasterizer cannot run: {missing}, or use auto")
    return load(backend)


def load(backend: str) -> Rasterizer:
    """Import a backend's module and return its rasterizer; that of Triton is a new one, which learns as it renders."""
    module = importlib.import_module(BACKENDS[backend])
    rasterizer: Rasterizer = module.TileRasterizer() if backend == "triton" else module.rasterize
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
