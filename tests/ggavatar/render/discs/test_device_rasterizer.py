"""Discs by Triton kernels, interpreted, against the float64 reference; compiled without spilling.

Also covers `ggavatar/render/discs/discs_triton.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from ggavatar.core import Camera, Rasterizer
from ggavatar.errors import InputError
from ggavatar.jit import device_kernels
from ggavatar.render.discs import rasterizer
from ggavatar.render.discs.values import DiscRendering, Discs
from tests.support.kernel_compiler import recorded_launches
from tests.support.render_scenes import random_camera, relative_error
from tests.support.triton_kernels import interpreted

pytestmark = interpreted


@pytest.fixture
def draw(monkeypatch: pytest.MonkeyPatch) -> Rasterizer:
    """What tensors on CUDA are drawn with, for tensors on the CPU."""
    monkeypatch.setattr(device_kernels, "missing", lambda kind: "")
    monkeypatch.setattr(device_kernels, "run_on", lambda *tensors: all(t.dtype is torch.float32 for t in tensors))
    return rasterizer.rasterizer("cuda")


def crowd(count: int, radius: float, spread: float = 0.3) -> Discs:
    generator = torch.Generator().manual_seed(count)
    means = spread * torch.randn(count, 3, generator=generator)
    one, quats = torch.ones(count, 3), torch.tensor([1.0, 0, 0, 0]).repeat(count, 1)
    return Discs(means, quats, one, one[:, 0], torch.rand(count, 3, generator=generator), radius=radius)


def with_gradients(
    rasterize: Rasterizer, discs: Discs, camera: Camera, dtype: torch.dtype
) -> tuple[DiscRendering, dict[str, Tensor]]:
    """The drawing, and gradients of a random linear function of image and alpha."""
    leaves = {name: getattr(discs, name).to(dtype, copy=True).requires_grad_() for name in ("means", "colors")}
    pose = camera.world_to_camera.to(dtype, copy=True).requires_grad_()
    other = {name: getattr(discs, name).to(dtype) for name in ("quats", "scales", "opacities")}
    view = Camera(camera.intrinsics.to(dtype), pose, camera.width, camera.height)
    drawn = rasterize(Discs(**leaves, **other, radius=discs.radius), view, torch.tensor([0.3, 0.9, 0.5], dtype=dtype))
    assert isinstance(drawn, DiscRendering)
    generator, loss = torch.Generator().manual_seed(7), pose.new_zeros(())
    for output in (drawn.image, drawn.alpha):
        loss = loss + (output * torch.randn(output.shape, generator=generator).to(dtype)).sum()
    loss.backward()
    return drawn, {"pose": pose.grad, **{name: leaf.grad for name, leaf in leaves.items()}, "at": drawn.means2d.grad}


def assert_same(
    found: tuple[DiscRendering, dict[str, Tensor]], expected: tuple[DiscRendering, dict[str, Tensor]]
) -> None:
    (fast, gradients), (slow, slow_gradients) = found, expected
    for name in ("image", "alpha", "depth"):
        torch.testing.assert_close(getattr(fast, name).double(), getattr(slow, name), atol=3e-5, rtol=1e-5)
    assert torch.equal(fast.shown, slow.shown) and fast.shown.any()
    assert gradients.keys() == slow_gradients.keys()
    errors = {name: relative_error(gradients[name], slow_gradients[name]) for name in gradients}
    assert max(errors.values()) < 1e-4, errors


@pytest.mark.parametrize(("count", "radius"), [(60, 0.25), (40, 0.05), (1, 0.5)])
def test_drawing_and_gradients_equal_the_reference_in_float64(count: int, radius: float, draw: Rasterizer) -> None:
    """The first scene has more than ten discs in many pixels, and discs that do not show."""
    discs, camera = crowd(count, radius), random_camera(37, 21, torch.float32, focal=30.0)
    expected = with_gradients(rasterizer.rasterizer("cpu", "reference"), discs, camera, torch.float64)
    with recorded_launches() as launches:
        found = with_gradients(draw, discs, camera, torch.float32)
    assert_same(found, expected)
    names = ["place_discs", "list_pairs", "finish_lists", "draw_discs", "differentiate_discs", "gather_discs"]
    assert [launch.name for launch in launches] == names
    if count == 60:
        assert not expected[0].shown.all()


def test_too_many_pairs_cost_time_and_no_pixels(draw: Rasterizer, monkeypatch: pytest.MonkeyPatch) -> None:
    from ggavatar.render.triton import capacity

    monkeypatch.setattr(capacity, "STEP", 8)
    monkeypatch.setattr(capacity, "FIRST_GUESS", 1.0)
    discs, camera = crowd(24, 0.4, spread=0.8), random_camera(37, 21, torch.float32, focal=30.0)
    expected = with_gradients(rasterizer.rasterizer("cpu", "reference"), discs, camera, torch.float64)
    assert (expected[0].radii == 0).any()
    for _ in range(2):
        assert_same(with_gradients(draw, discs, camera, torch.float32), expected)


def test_a_disc_in_the_middle_of_a_pixel_has_finite_gradients(draw: Rasterizer) -> None:
    """Alpha is 1 there, and nothing of what is behind is seen."""
    discs = crowd(2, 0.5)
    means = torch.tensor([[0.005, 0.005, 1.0], [0.005, 0.005, 1.1]])
    camera = Camera(torch.tensor([[100.0, 0, 10], [0, 100, 10], [0, 0, 1]]), torch.eye(4), 20, 20)
    centered = Discs(means, discs.quats, discs.scales, discs.opacities, discs.colors, radius=0.47)
    found = with_gradients(draw, centered, camera, torch.float32)
    assert found[0].alpha.max() > 0.999999
    assert_same(found, with_gradients(rasterizer.rasterizer("cpu", "reference"), centered, camera, torch.float64))


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
@pytest.mark.parametrize("field", ["means", "colors"])
def test_nan_is_named_at_a_later_call(field: str, draw: Rasterizer) -> None:
    discs, camera = crowd(3, 0.2), random_camera(20, 17, torch.float32)
    getattr(discs, field)[1, 2] = float("nan")
    draw(discs, camera, torch.ones(3))
    with pytest.raises(InputError, match=rf"^gaussians\.{field}: expected finite numbers"):
        draw(crowd(3, 0.2), camera, torch.ones(3))


def test_other_dtypes_and_no_discs_go_to_the_reference(draw: Rasterizer) -> None:
    camera = random_camera(20, 17, torch.float32)
    with recorded_launches() as launches:
        assert draw(crowd(0, 0.2), camera, 0.5 * torch.ones(3)).image.mean() == 0.5
        with_gradients(draw, crowd(3, 0.2), camera, torch.float64)
    assert launches == []


def test_kernels_compile_without_spilling(draw: Rasterizer, registers_of: Callable[..., dict[str, Any]]) -> None:
    with recorded_launches() as launches:
        with_gradients(draw, crowd(3, 0.2), random_camera(8, 8, torch.float32), torch.float32)
    found = registers_of([launch for launch in launches if "disc" in launch.name])
    assert len(found) == 4 and max(found.values()) <= 64
