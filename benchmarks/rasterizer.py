"""The CPU rasterizer against a tiled one in plain torch and against the reference, forward and backward."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch

from benchmarks import torch_tiled
from benchmarks.measure import Timing, interleaved, peak_extra_megabytes, threads
from benchmarks.scenes import FIELDS, head
from ggavatar.core import Camera, Gaussians, Rasterizer
from ggavatar.io.ordered_map import cores
from ggavatar.render import reference
from ggavatar.render.cpu import rasterizer

SCENES = ((10_000, 256), (50_000, 512))
QUICK_SCENES = ((2_000, 128),)
MEMORY_SCENE = (100_000, 512)
WHITE = torch.ones(3)


def step(rasterize: Rasterizer, gaussians: Gaussians, camera: Camera) -> Callable[[], object]:
    """One forward and backward pass with a fixed gradient of the image."""
    incoming = torch.randn(camera.height, camera.width, 3, generator=torch.Generator().manual_seed(1))

    def call() -> None:
        for name in FIELDS:
            getattr(gaussians, name).grad = None
        rasterize(gaussians, camera, WHITE).image.backward(incoming)

    return call


def forward(rasterize: Rasterizer, gaussians: Gaussians, camera: Camera) -> Callable[[], object]:
    """One forward pass."""

    def call() -> None:
        rasterize(gaussians, camera, WHITE)

    return call


def compare(count: int, size: int, rounds: int, wall_threads: int) -> dict[str, object]:
    """Time all candidates on one scene."""
    gaussians, camera = head(count, size)
    difference = agreement(gaussians, camera)
    candidates = {
        "cpu": step(rasterizer.rasterize, gaussians, camera),
        "torch_tiled": step(torch_tiled.rasterize, gaussians, camera),
        "reference": step(reference.rasterize, gaussians, camera),
        "cpu_forward": forward(rasterizer.rasterize, gaussians, camera),
    }
    with threads(1):
        single = interleaved(candidates, rounds)
        ours = repeated(candidates["cpu"], rounds)
    with threads(wall_threads):
        parallel = interleaved({name: candidates[name] for name in ("cpu", "torch_tiled")}, rounds)
        ours_parallel = repeated(candidates["cpu"], rounds)
    return {
        "gaussians": count,
        "size": size,
        "one_thread": {name: timing.as_dict() for name, timing in single.items()},
        "all_cores": {name: timing.as_dict() for name, timing in parallel.items()},
        "cpu_alone_one_thread": ours.as_dict(),
        "cpu_alone_all_cores": ours_parallel.as_dict(),
        "wall_threads": wall_threads,
        "ratio_vs_torch_tiled": round(single["torch_tiled"].cpu_ms / single["cpu"].cpu_ms, 1),
        "ratio_vs_reference": round(single["reference"].cpu_ms / single["cpu"].cpu_ms, 1),
        "wall_ratio_vs_torch_tiled": round(parallel["torch_tiled"].wall_ms / parallel["cpu"].wall_ms, 1),
        "image_difference": difference,
    }


def repeated(call: Callable[[], object], rounds: int) -> Timing:
    """The CPU backend alone, repeatedly as in training, with warm caches."""
    return interleaved({"cpu": call}, 4 * rounds, warm_up=2)["cpu"]


@torch.no_grad()
def agreement(gaussians: Gaussians, camera: Camera) -> float:
    """Mean absolute difference of our image and the tiled one; timings compare only if the images agree."""
    found, expected = rasterizer.rasterize(gaussians, camera, WHITE), torch_tiled.rasterize(gaussians, camera, WHITE)
    difference = float((found.image - expected.image).abs().mean())
    if difference > 1e-4:
        raise RuntimeError(f"the rasterizers differ by {difference:.1e}: the comparison would be meaningless")
    return difference


def memory(count: int, size: int) -> dict[str, object]:
    """Additional memory of one step including its gradients; the kernels are compiled before."""
    step(rasterizer.rasterize, *head(100, 32))()
    gaussians, camera = head(count, size)
    extra = peak_extra_megabytes(step(rasterizer.rasterize, gaussians, camera))
    gradients = sum(getattr(gaussians, name).nbytes for name in FIELDS) / 2**20
    return {"gaussians": count, "size": size, "extra_mb": extra, "gradients_mb": round(gradients, 1)}


def run(options: argparse.Namespace) -> dict[str, object]:
    """Measure the memory of a step, before anything else grows the heap, and then time all scenes."""
    scenes, largest = (QUICK_SCENES, QUICK_SCENES[-1]) if options.quick else (SCENES, MEMORY_SCENE)
    used = memory(*largest)
    rounds, wall_threads = options.repeats or 5, options.threads or cores()
    return {"memory": used, "scenes": [compare(count, size, rounds, wall_threads) for count, size in scenes]}
