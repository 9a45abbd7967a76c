"""What this computer has for the commands: versions, devices, rasterizers, model files, caches, and what is missing."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch

from ggavatar.io.cache_folder import cache_folder
from ggavatar.plugins.entry_points import KINDS, listed
from ggavatar.pretrained.catalogue import MODELS
from ggavatar.pretrained.folders import is_offline
from ggavatar.pretrained.resolve import ModelFinder, files_of
from ggavatar.render.backends import BACKENDS, choice, lacking, resolve_device

PACKAGES = ("ggavatar", "torch", "numpy", "numba", "scipy", "opencv-contrib-python-headless", "av", "tyro", "rich")
OPTIONAL = {
    "viser": "ggavatar-view and ggavatar-train --view; pip install 'ggavatar[view]'",
    "ray": "ggavatar-sweep --backend ray; pip install 'ggavatar[ray]'",
    "triton": "the fast rasterizer on NVIDIA GPUs; comes with torch's CUDA wheels on Linux",
    "gsplat": "another rasterizer on NVIDIA GPUs; pip install 'ggavatar[cuda]'",
    "onnxruntime": "ggavatar-prep --masks rvm; pip install onnxruntime",
}
"""Packages that some commands do without, and for what they are needed."""
VARIABLES = ("GGAVATAR_MODELS", "GGAVATAR_CACHE", "GGAVATAR_OFFLINE", "CUDA_VISIBLE_DEVICES", "OMP_NUM_THREADS")
CACHES = ("models", "compiled")


def environment() -> dict[str, Any]:
    """The report of `ggavatar-doctor --environment`, as plain data."""
    device = resolve_device("auto")
    kind = torch.device(device).type
    chosen, passed_over = choice(kind)
    models = {name: _model(name) for name in MODELS}
    report = {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "optional": {name: {"version": _version(name), "for": text} for name, text in OPTIONAL.items()},
        "system": {"platform": platform.platform(), "processors": os.cpu_count(), "torch_threads": _threads()},
        "device": {"auto": device, "cuda_of_torch": torch.version.cuda, "found": _devices()},
        "rasterizer": {
            "auto": chosen,
            "passed_over": passed_over,
            "lacking": {name: lacking(name, kind) for name in BACKENDS},
        },
        "models": models,
        "caches": {name: _cache(cache_folder(name)) for name in CACHES},
        "variables": {name: os.environ[name] for name in VARIABLES if name in os.environ},
        "plugins": _plugins(),
    }
    return {**report, "missing": list(_missing(report))}


def environment_lines(report: Mapping[str, Any]) -> list[str]:
    """The same report as text."""
    versions, device, rasterizer = report["versions"], report["device"], report["rasterizer"]
    system = report["system"]
    lines = [
        "versions: " + ", ".join(f"{name} {version or 'not found'}" for name, version in versions.items()),
        f"system: {system['platform']}, {system['processors']} processors",
        f"device: {device['auto']} (torch is built {_built(device['cuda_of_torch'])})",
        *(f"  {found['name']}, {found['memory_mib']} MiB" for found in device["found"]),
        f"rasterizer: {rasterizer['auto']}",
        *(f"  {name}: {why or 'can run'}" for name, why in rasterizer["lacking"].items()),
        "optional packages:",
        *(f"  {name} {one['version'] or 'not installed'}: {one['for']}" for name, one in report["optional"].items()),
        "model files:",
        *(f"  {name:<20}{one['path'] or 'missing'}" for name, one in report["models"].items()),
        "caches:",
        *(f"  {name}: {one['path']}, {_size(one)}" for name, one in report["caches"].items()),
    ]
    lines += [f"variable: {name}={value}" for name, value in report["variables"].items()]
    lines += [f"plug-ins for {group}: {', '.join(names)}" for group, names in report["plugins"].items()]
    return [*lines, *(f"missing: {text}" for text in report["missing"] or ["nothing that the commands need"])]


def _missing(report: Mapping[str, Any]) -> Iterator[str]:
    """What is missing for the best results on this computer, each with what to do."""
    for why in report["rasterizer"]["passed_over"]:
        yield f"a faster rasterizer than {report['rasterizer']['auto']}: {why}"
    absent = [name for name, one in report["models"].items() if one["path"] is None]
    if absent:
        how = "offline, copy their files into $GGAVATAR_MODELS" if is_offline() else "fetch them with"
        yield f"model files {', '.join(absent)}; {how}: ggavatar-models --fetch {' '.join(absent)}"
    for name, one in report["caches"].items():
        if not one["writable"]:
            yield f"a writable folder for the cache of {name}, {one['path']}; set $GGAVATAR_CACHE to another folder"
    if report["device"]["auto"] == "cpu" and report["device"]["cuda_of_torch"] is not None:
        yield "a CUDA device: torch is built for CUDA but finds none; check the driver and $CUDA_VISIBLE_DEVICES"


def _version(name: str) -> str | None:
    """The installed version of a package; None if it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _threads() -> int:
    return torch.get_num_threads()


def _devices() -> list[dict[str, Any]]:
    """Name and memory of every CUDA device that torch sees."""
    if not torch.cuda.is_available():
        return []
    found = (torch.cuda.get_device_properties(number) for number in range(torch.cuda.device_count()))
    return [{"name": one.name, "memory_mib": one.total_memory >> 20} for one in found]


def _model(name: str) -> dict[str, Any]:
    """Where the file of a model is; its contents are not checked."""
    here = files_of(MODELS[name], ModelFinder(offline=True).folders)
    return {"path": str(here[0]) if here else None, "for": MODELS[name].purpose}


def _cache(folder: Path) -> dict[str, Any]:
    """Place and size of a cache, and whether it can be written to."""
    files = [path for path in folder.rglob("*") if path.is_file()] if folder.is_dir() else []
    existing = next((one for one in (folder, *folder.parents) if one.is_dir()), None)
    is_writable = existing is not None and os.access(existing, os.W_OK | os.X_OK)
    return {
        "path": str(folder),
        "files": len(files),
        "bytes": sum(path.stat().st_size for path in files),
        "writable": is_writable,
    }


def _plugins() -> dict[str, list[str]]:
    """Names of what packages other than this one register, by group, with what is wrong with them."""
    groups = {group: listed(group) for group in KINDS}
    found = {
        group: [
            *(f"{plugin.name} ({plugin.package} {plugin.version})" for plugin in plugins.usable.values()),
            *plugins.problems.values(),
        ]
        for group, plugins in groups.items()
    }
    return {group: sorted(names) for group, names in found.items() if names}


def _built(cuda: str | None) -> str:
    return f"for CUDA {cuda}" if cuda else "without CUDA"


def _size(cache: Mapping[str, Any]) -> str:
    return f"{cache['files']} files, {cache['bytes'] / 1e6:.1f} MB{'' if cache['writable'] else ', not writable'}"
