"""All that has kernels for CUDA, called as a training calls it, on a GPU against float64 on the CPU.

Where there is no GPU, the same calls are rehearsed with interpreted kernels.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians
from ggavatar.gaussians import binding, offsets
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.offsets import Offsets, refine
from ggavatar.geometry import triangles
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.jit import device_kernels
from ggavatar.losses import dssim
from ggavatar.losses.dssim import image_terms
from ggavatar.networks import fields
from ggavatar.networks.fields import Box, HashTriplane, HashTriplaneConfig
from ggavatar.render.backends import pick
from ggavatar.render.discs import rasterizer as discs
from ggavatar.render.discs.values import Discs
from tests.support.kernel_compiler import recorded_launches
from tests.support.render_scenes import random_camera, relative_error
from tests.support.triton_kernels import interpreted

COUNT = 40


def normal(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def whole_step(device: str, dtype: torch.dtype) -> dict[str, Tensor]:
    """Losses of Gaussians and of discs on triangles with offsets from a field, and the gradients of what is learned."""

    def learned(value: Tensor) -> Tensor:
        return value.to(device, dtype, copy=True).requires_grad_()

    field = HashTriplane(HashTriplaneConfig(levels=3), Box(), torch.Generator().manual_seed(1)).to(device, dtype)
    with torch.no_grad():
        field.tables.copy_(normal(*field.tables.shape, seed=2))
    local = 0.3 * normal(COUNT, 3, seed=3), normal(COUNT, 4, seed=4), normal(COUNT, 3, seed=5) - 2
    leaves = [learned(value) for value in local]
    vertices = 0.3 * normal(12, 3, seed=6).to(device, dtype)
    faces = torch.arange(12, device=device).reshape(4, 3)
    frames = triangle_frames(vertices, faces)
    placed = bind(*leaves, torch.arange(COUNT, device=device) % 4, frames)
    features = field(0.1 * normal(COUNT, 3, seed=7).to(device, dtype))
    placed = refine(*placed, Offsets(0.1 * features[:, :10]))
    camera = random_camera(24, 20, dtype, focal=25.0)
    camera = Camera(camera.intrinsics.to(device), camera.world_to_camera.to(device), 24, 20)
    given = normal(COUNT, 3, seed=8), normal(COUNT, seed=9), normal(20, 24, 3, seed=10)
    colors, opacities, target = (value.sigmoid().to(device, dtype) for value in given)
    background = torch.ones(3, device=device, dtype=dtype)
    drawn = pick(device)(Gaussians(*placed, 0.98 * opacities, colors), camera, background)
    dots = Discs(*placed, opacities, colors, radius=0.2)
    dotted = discs.rasterizer(device)(dots, camera, background)
    terms = image_terms(drawn.image, target, 0.2)
    loss = terms.l1 + terms.dssim + drawn.alpha.mean() + image_terms(dotted.image, target, 0.2).dssim
    gradients = torch.autograd.grad(loss, [*leaves, field.tables])
    return {"loss": loss.detach(), **dict(zip(("means", "quats", "log_scales", "tables"), gradients, strict=True))}


def assert_right(found: dict[str, Tensor]) -> None:
    expected = whole_step("cpu", torch.float64)
    assert max(relative_error(value.cpu(), expected[name]) for name, value in found.items()) < 1e-3


@interpreted
def test_a_step_rehearsed_with_interpreted_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    from ggavatar.render.triton.rasterizer import TileRasterizer

    with monkeypatch.context() as change:
        for module in (fields, dssim, binding, offsets, triangles):
            change.setattr(module, "compiled_for", lambda *_: False)
        change.setattr(device_kernels, "missing", lambda kind: "")
        change.setattr(device_kernels, "run_on", lambda *tensors: all(t.dtype != torch.float64 for t in tensors))
        change.setitem(globals(), "pick", lambda _: TileRasterizer())
        on_cuda = discs.rasterizer("cuda")
        change.setattr(discs, "rasterizer", lambda _: on_cuda)
        with recorded_launches() as launches:
            found = whole_step("cpu", torch.float32)
    assert_right(found)
    assert {launch.name for launch in launches} >= {
        *("place_frames", "bind_gaussians", "look_up_points", "refine_gaussians", "draw_tiles", "draw_discs"),
        *("compare", "differentiate_terms", "differentiate_tiles", "differentiate_discs", "differentiate_gaussians"),
        *("differentiate_refinement", "spread_gradient", "differentiate_binding"),
    }


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_step_on_a_gpu() -> None:
    assert_right(whole_step("cuda", torch.float32))
