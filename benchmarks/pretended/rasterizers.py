"""Stand-ins for rasterizers on CUDA: the CPU's pictures and gradients, counted as a given number of launches.

A rasterizer of ours on CUDA launches kernels that a pretended tensor cannot be given. What `stand_ins` replaces is
listed in one place: a new kernel on CUDA gets its line there, with the number of launches that it is known to make.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple
from unittest import mock

import torch
from torch import Tensor

from benchmarks.pretended.tally import Tally
from benchmarks.pretended.tensors import PretendedTensor, inner
from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.render.discs import rasterizer as discs

SPLATTED = ("means", "quats", "scales", "opacities", "colors")


class Launches(NamedTuple):
    """How many kernels a rasterizer launches in each direction."""

    forward: int
    backward: int


RASTERIZER = Launches(1, 1)
"""One operation each way, until the number of a measured rasterizer is put in its place."""


@contextlib.contextmanager
def stand_ins() -> Iterator[None]:
    """While active, the rasterizers that are picked for CUDA are stand-ins."""
    from ggavatar.methods import point_avatar
    from ggavatar.render import backends
    from ggavatar.render.cpu import rasterizer as cpu

    pick = backends.pick

    def picked(device: Any, backend: str = "auto") -> Any:
        return stand_in(cpu.rasterize) if torch.device(device).type == "cuda" else pick(device, backend)

    def picked_discs(device: Any, backend: str = "auto") -> Any:
        is_cuda = torch.device(device).type == "cuda"
        return stand_in(discs.rasterize) if is_cuda else discs.rasterizer(device, backend)

    with (
        mock.patch.object(backends, "pick", picked),
        mock.patch.object(point_avatar, "disc_rasterizer", picked_discs),
    ):
        yield


def stand_in(rasterize: Callable[..., Rendering], launches: Launches = RASTERIZER) -> Callable[..., Rendering]:
    """A rasterizer of pretended tensors, given one of tensors on the CPU."""

    def draw(gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        """Draw on the CPU and count it; what belongs to the device is pretended again."""
        named = [getattr(gaussians, name) for name in SPLATTED]
        if not all(isinstance(value, PretendedTensor) for value in named):
            raise RuntimeError("expected all Gaussians on cuda:0")
        tally: Tally = named[0].tally
        found: dict[str, Any] = {}
        setting = (rasterize, gaussians, camera, background, launches, found)
        image, alpha, depth = _Draw.apply(setting, *named, camera.world_to_camera)
        drawn: Rendering = found["drawn"]
        changes: dict[str, Any] = {"image": image, "alpha": alpha, "depth": depth}
        means2d = PretendedTensor(drawn.means2d.detach().clone(), tally)
        changes["means2d"] = found["means2d"] = means2d.requires_grad_(drawn.means2d.requires_grad)
        for name in ("radii", "shown"):
            if hasattr(drawn, name):
                changes[name] = PretendedTensor(getattr(drawn, name).detach(), tally)
        return dataclasses.replace(drawn, **changes)

    return draw


class _Draw(torch.autograd.Function):
    """The drawing on the CPU; its gradients are those of the rasterizer there."""

    @staticmethod
    def forward(ctx: Any, setting: Any, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Image, alpha and depth; the rendering itself is left in the setting."""
        rasterize, gaussians, camera, background, launches, found = setting
        wanted = ctx.needs_input_grad[1:]
        with torch._C.DisableTorchFunction(), torch.enable_grad():
            leaves = [inner(v).detach().clone().requires_grad_(w) for v, w in zip(tensors, wanted, strict=True)]
            splats = dataclasses.replace(gaussians, **dict(zip(SPLATTED, leaves[:-1], strict=True)))
            view = dataclasses.replace(camera, intrinsics=inner(camera.intrinsics).detach(), world_to_camera=leaves[-1])
            drawn = rasterize(splats, view, inner(background).detach())
        tally: Tally = gaussians.means.tally
        tally.launch("rasterizer, forward", launches.forward)
        ctx.leaves, ctx.tally, ctx.launches, ctx.found = leaves, tally, launches, found
        found["drawn"] = drawn
        depth = PretendedTensor(drawn.depth.detach().clone(), tally)
        ctx.mark_non_differentiable(depth)
        return (*(PretendedTensor(part.detach().clone(), tally) for part in (drawn.image, drawn.alpha)), depth)

    @staticmethod
    def backward(ctx: Any, to_image: Tensor, to_alpha: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of the splatted columns and the pose; those of the projected means are left on them."""
        drawn = ctx.found["drawn"]
        wanted = [leaf for leaf in ctx.leaves if leaf.requires_grad]
        upstream = [inner(to_image).contiguous(), inner(to_alpha).contiguous()]
        with torch._C.DisableTorchFunction():
            inputs = [*wanted, *([drawn.means2d] if drawn.means2d.requires_grad else [])]
            outputs = [
                (value, up)
                for value, up in zip((drawn.image, drawn.alpha), upstream, strict=True)
                if value.requires_grad
            ]
            found = torch.autograd.grad(
                [value for value, _ in outputs], inputs, [up for _, up in outputs], allow_unused=True, retain_graph=True
            )
        ctx.tally.launch("rasterizer, backward", ctx.launches.backward)
        if drawn.means2d.requires_grad and found[-1] is not None:
            ctx.found["means2d"].grad = PretendedTensor(found[-1], ctx.tally)
        by_leaf = dict(zip(map(id, wanted), found, strict=False))  # the last gradient is that of the centers
        gradients = [by_leaf.get(id(leaf)) for leaf in ctx.leaves]
        return None, *(None if value is None else PretendedTensor(value, ctx.tally) for value in gradients)
