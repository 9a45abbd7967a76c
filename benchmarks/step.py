"""A training step and each compiled component against its counterpart in plain torch, forward and backward."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from benchmarks.measure import Timing, interleaved, threads
from benchmarks.step_scene import StepScene
from ggavatar.gaussians.binding import bind, bind_in_torch
from ggavatar.gaussians.offsets import Offsets, refine, refine_in_torch
from ggavatar.io.ordered_map import available_cores
from ggavatar.losses.dssim import image_terms, image_terms_in_torch
from ggavatar.losses.terms import (
    log_scale_regularizer,
    log_scale_regularizer_in_torch,
    position_regularizer,
    position_regularizer_in_torch,
)
from ggavatar.networks.fields import HashTriplane, lookup_in_torch
from ggavatar.networks.mlp import perceptron, perceptron_in_torch

COUNT, SIZE = 50_000, 512
QUICK_COUNT, QUICK_SIZE = 5_000, 128

Call = Callable[[], object]


def components(scene: StepScene) -> dict[str, tuple[Call, Call]]:
    """Every compiled component and its torch counterpart on the same inputs."""
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(scene.size, scene.size, 3, generator=generator).requires_grad_()
    rows = scene.rows
    local = rows["means"], rows["quats"], rows["log_scales"]
    means, quats, scales = (value.detach().requires_grad_() for value in scene.placed(scene.neutral))
    offsets = torch.randn(scene.count, 10, generator=generator).mul_(0.1).requires_grad_()
    visible = torch.rand(scene.count, generator=generator) < 0.8
    drawn = [
        torch.randn(scene.count, width, generator=generator) for width in (3, 4, 3, 10, scene.adjuster.field.width)
    ]
    shape = drawn[:3]
    return {
        "image_terms": (
            backward(lambda: image_terms(image, scene.kept_target, 0.2)),
            backward(lambda: image_terms_in_torch(image, scene.kept_target, (0.8, 0.2))),
        ),
        "regularizers": (
            backward(lambda: [position_regularizer(rows["means"], visible), log_scale_regularizer(local[2], visible)]),
            backward(
                lambda: [
                    position_regularizer_in_torch(rows["means"], visible),
                    log_scale_regularizer_in_torch(local[2], visible),
                ]
            ),
        ),
        "bind": (
            backward(lambda: bind(*local, scene.face, scene.neutral), shape),
            backward(lambda: bind_in_torch(*local, scene.face, scene.neutral), shape),
        ),
        "refine": (
            backward(lambda: refine(means, quats, scales, Offsets(offsets)), shape),
            backward(lambda: refine_in_torch(means, quats, scales, Offsets(offsets)), shape),
        ),
        **field_components(scene, drawn[3], drawn[4]),
    }


def field_components(scene: StepScene, upstream: Tensor, to_features: Tensor) -> dict[str, tuple[Call, Call]]:
    """The tri-plane, the network after it, and both with the latent network."""
    adjuster, x = scene.adjuster, scene.positions()
    field = adjuster.field
    assert isinstance(field, HashTriplane)
    unit = field.box.normalize(x)
    features = field(x).detach().requires_grad_()

    def layers() -> list[tuple[Tensor, Tensor]]:
        weight, bias = adjuster._contracted(adjuster.latent(scene.condition))
        return [(part.weight, part.bias) for part in (adjuster.first, adjuster.second)] + [(weight, bias)]

    def look_up() -> Tensor:
        return lookup_in_torch(unit, field.tables, field.levels)

    return {
        "triplane": (backward(lambda: [field(x)], [to_features]), backward(lambda: [look_up()], [to_features])),
        "network": (
            backward(lambda: [perceptron(features, *layers())], [upstream]),
            backward(lambda: [perceptron_in_torch(features, *layers())], [upstream]),
        ),
        "adjuster": (
            backward(lambda: [adjuster(x, scene.condition).rows], [upstream]),
            backward(lambda: [perceptron_in_torch(look_up(), *layers())], [upstream]),
        ),
    }


def backward(outputs: Callable[[], Sequence[Tensor]], upstream: Sequence[Tensor] | None = None) -> Call:
    """A call that computes outputs and backpropagates through them."""

    def call() -> None:
        torch.autograd.backward(tuple(outputs()), upstream)

    return call


def single_components(scene: StepScene) -> dict[str, Call]:
    """Components that stay in torch, and the rasterizer for comparison."""
    incoming = torch.randn(scene.size, scene.size, 3, generator=torch.Generator().manual_seed(2))
    for parameter in [*scene.rows.values(), *scene.adjuster.parameters()]:
        parameter.grad = torch.zeros_like(parameter)

    def rasterize() -> None:
        scene.render(adjusted=False).image.backward(incoming)

    return {
        "bind_and_rasterize": rasterize,
        "skinned_head_and_frames": scene.posed_frames,
        "adam_of_rows": scene.optimizers[0].step,
        "adam_of_adjuster": scene.optimizers[1].step,
    }


def compare(scene: StepScene, rounds: int) -> dict[str, object]:
    """Time every component on one thread: ours, its torch counterpart, and the ratio of CPU times."""
    found: dict[str, object] = {}
    for name, (ours, in_plain_torch) in components(scene).items():
        timing = interleaved({"compiled": ours, "torch": in_plain_torch}, rounds)
        found[name] = {kind: value.as_dict() for kind, value in timing.items()} | {"ratio": ratio(timing)}
    for name, call in single_components(scene).items():
        found[name] = {"ours": interleaved({name: call}, rounds)[name].as_dict()}
    return found


def ratio(timing: dict[str, Timing]) -> float:
    """CPU time of the torch counterpart over ours."""
    return round(timing["torch"].cpu_ms / timing["compiled"].cpu_ms, 1)


def whole_steps(scene: StepScene, rounds: int) -> dict[str, object]:
    """Time whole steps in both phases of the schedule, without a perceptual term."""
    phases = {"neutral": lambda: scene.step(adjusted=False), "adjusted": lambda: scene.step(adjusted=True)}
    return {name: interleaved({name: call}, rounds, warm_up=3)[name].as_dict() for name, call in phases.items()}


def run(options: argparse.Namespace) -> dict[str, object]:
    """Measure components on one thread, and whole steps on one thread and on all cores."""
    wall_threads, rounds = options.threads or available_cores(), options.repeats or 7
    scene = StepScene(QUICK_COUNT, QUICK_SIZE) if options.quick else StepScene(COUNT, SIZE)
    with threads(1):
        result: dict[str, object] = {"one_thread": whole_steps(scene, 3 * rounds), "pieces": compare(scene, rounds)}
    with threads(wall_threads):
        result["all_cores"] = whole_steps(scene, 3 * rounds)
    return {"gaussians": scene.count, "size": scene.size, "wall_threads": wall_threads} | result
