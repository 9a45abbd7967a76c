"""Discs against closed forms, the float64 reference against gradcheck, and the kernels against the reference.

Also covers `ggavatar/render/discs/kernel.py`, `ggavatar/render/discs/stages.py`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rasterizer
from ggavatar.errors import InputError
from ggavatar.render.cpu.rasterizer import rasterize as rasterize_gaussians
from ggavatar.render.discs import rasterizer, reference
from ggavatar.render.discs.values import DiscRendering, Discs, radius_in_pixels, similar_scale
from ggavatar.training import registry
from tests.support.render_scenes import random_camera


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def made(means: Tensor, colors: Tensor, radius: float) -> Discs:
    """Discs with placeholders for what is not drawn."""
    one = torch.ones_like(means)
    quats = torch.cat((one[:, :1], torch.zeros_like(one)), dim=1)
    return Discs(means, quats, one, one[:, 0], colors, radius=radius)


def random_discs(count: int, radius: float, dtype: torch.dtype, seed: int = 0, spread: float = 0.3) -> Discs:
    generator = torch.Generator().manual_seed(seed)
    means = spread * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return made(means.to(dtype), torch.rand(count, 3, generator=generator, dtype=torch.float64).to(dtype), radius)


def straight_camera(size: int, dtype: torch.dtype = torch.float32) -> Camera:
    """One meter in front of the origin lies one pixel per centimeter."""
    intrinsics = torch.tensor([[100.0, 0, size / 2], [0, 100.0, size / 2], [0, 0, 1]], dtype=dtype)
    return Camera(intrinsics, torch.eye(4, dtype=dtype), size, size)


def gradients(
    rasterize: Rasterizer, scene: Discs, camera: Camera, dtype: torch.dtype
) -> tuple[DiscRendering, dict[str, Tensor]]:
    """The drawing in `dtype`, and gradients of a random linear function of image and alpha, in float64."""
    leaves = {name: getattr(scene, name).detach().to(dtype).requires_grad_() for name in ("means", "colors")}
    pose = camera.world_to_camera.to(dtype).requires_grad_()
    view = Camera(camera.intrinsics.to(dtype), pose, camera.width, camera.height)
    background = torch.tensor([0.3, 0.9, 0.5], dtype=dtype)
    drawn = rasterize(dataclasses.replace(made(leaves["means"], leaves["colors"], scene.radius)), view, background)
    assert isinstance(drawn, DiscRendering)
    generator, loss = torch.Generator().manual_seed(7), pose.new_zeros(())
    for output in (drawn.image, drawn.alpha):
        loss = loss + (output * torch.randn(output.shape, generator=generator, dtype=torch.float64).to(dtype)).sum()
    loss.backward()
    leaves |= {"pose": pose, "means2d": drawn.means2d}
    return drawn, {name: leaf.grad.double() for name, leaf in leaves.items() if leaf.grad is not None}


@pytest.mark.parametrize("rasterize", [rasterizer.rasterize, reference.rasterize])
def test_one_disc_is_a_paraboloid(rasterize: Rasterizer) -> None:
    camera, color = straight_camera(21), torch.tensor([[0.2, 0.4, 0.8]])
    scene = made(torch.tensor([[0.013, -0.021, 1.0]]), color, radius=0.5)
    reach = 0.5 * 21 / 2
    assert radius_in_pixels(0.5, camera) == reach
    drawn = rasterize(scene, camera, torch.ones(3))
    x = torch.arange(21) + 0.5
    square = (x[None] - 10.5 - 1.3).square() + (x[:, None] - 10.5 + 2.1).square()
    alpha = (1 - square / reach**2).clamp_min(0)[..., None]
    assert torch.allclose(drawn.alpha, alpha, atol=1e-5) and (alpha > 0).sum() > 50
    assert torch.allclose(drawn.image, alpha * color + (1 - alpha), atol=1e-5)
    assert torch.allclose(drawn.depth, alpha, atol=1e-5)


@pytest.mark.parametrize("rasterize", [rasterizer.rasterize, reference.rasterize])
def test_only_the_ten_nearest_discs_show(rasterize: Rasterizer) -> None:
    """Twelve discs beside a pixel: by hand, the first ten are blended, and the two behind them change nothing."""
    camera, count = straight_camera(3), 12
    depths = torch.linspace(1.0, 2.0, count).flip(0)
    means = torch.stack((0.008 * depths, torch.zeros(count), depths), dim=1)
    colors = torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
    drawn = rasterize(made(means, colors, radius=1.0), camera, torch.zeros(3))
    alpha, light, expected = 1 - 0.8**2 / 1.5**2, 1.0, torch.zeros(3)
    for number in range(count - 1, count - 1 - 10, -1):
        expected, light = expected + light * alpha * colors[number], light * (1 - alpha)
    assert torch.allclose(drawn.image[1, 1], expected, atol=1e-6)
    assert torch.allclose(drawn.alpha[1, 1], torch.tensor([1 - light]), atol=1e-6) and light > 1e-6
    assert drawn.shown.tolist() == [False] * 11 + [True]


def test_a_disc_shows_when_it_comes_first_or_weighs_more_than_a_half() -> None:
    camera = straight_camera(1)
    for offset, expected in ((1.0, False), (1.2, True)):
        beside = torch.tensor([[0.01 * offset * 0.35, 0.0, 1.0], [0.0, 0.0, 1.5]])
        drawn = rasterizer.rasterize(made(beside, torch.rand(2, 3), radius=1.0), camera, torch.zeros(3))
        light = (offset * 0.35 / 0.5) ** 2
        assert bool(drawn.shown[0]) and bool(drawn.shown[1]) == (light > 0.5) == expected


def test_the_reference_has_the_gradients_of_its_values() -> None:
    camera = random_camera(9, 7, torch.float64, focal=12.0)
    scene = random_discs(14, 0.6, torch.float64, spread=0.15)

    def drawn(means: Tensor, colors: Tensor) -> tuple[Tensor, ...]:
        picture = reference.rasterize(made(means, colors, 0.6), camera, torch.ones(3, dtype=torch.float64))
        return picture.image, picture.alpha, picture.depth

    assert torch.autograd.gradcheck(drawn, (scene.means.requires_grad_(), scene.colors.requires_grad_()))


@pytest.mark.parametrize(
    ("count", "radius", "width", "height", "spread"),
    [(300, 0.1, 61, 45, 0.3), (3000, 0.05, 64, 48, 0.2), (40, 0.5, 40, 33, 0.3), (400, 0.02, 50, 70, 0.9)],
)
def test_kernels_agree_with_the_reference(count: int, radius: float, width: int, height: int, spread: float) -> None:
    camera, scene = random_camera(width, height, torch.float64), random_discs(count, radius, torch.float64, 1, spread)
    drawn, found = gradients(rasterizer.rasterize, scene, camera, torch.float32)
    expected, wanted = gradients(reference.rasterize, scene, camera, torch.float64)
    for name in ("image", "alpha", "depth"):
        assert torch.allclose(getattr(drawn, name).double(), getattr(expected, name), atol=2e-4), name
    assert found.keys() == wanted.keys() == {"means", "colors", "pose", "means2d"}
    for name, gradient in wanted.items():
        assert (found[name] - gradient).norm() < 2e-4 * gradient.norm(), name
    assert torch.equal(drawn.radii > 0, expected.radii > 0) and (drawn.shown != expected.shown).sum() <= 1
    assert 0 < drawn.shown.sum() < count


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bits(threads: int) -> None:
    camera, scene = random_camera(150, 130, torch.float32), random_discs(5000, 0.03, torch.float32)
    torch.set_num_threads(1)
    expected, wanted = gradients(rasterizer.rasterize, scene, camera, torch.float32)
    torch.set_num_threads(threads)
    for _ in range(3):
        drawn, found = gradients(rasterizer.rasterize, scene, camera, torch.float32)
        assert all(torch.equal(getattr(drawn, n), getattr(expected, n)) for n in ("image", "alpha", "depth", "shown"))
        # The pose's gradient is a sum of torch's, whose order is torch's own; no method trains cameras.
        assert all(torch.equal(found[name], wanted[name]) for name in ("means", "colors", "means2d"))


def test_nothing_in_view_gives_the_background() -> None:
    behind = random_discs(5, 0.1, torch.float32).means - torch.tensor([0.0, 0.0, 5.0])
    drawn = rasterizer.rasterize(
        made(behind, torch.rand(5, 3), 0.1), straight_camera(20), torch.tensor([0.1, 0.2, 0.3])
    )
    assert torch.allclose(drawn.image, torch.tensor([0.1, 0.2, 0.3]).expand(20, 20, 3)) and not drawn.shown.any()


def test_what_is_refused() -> None:
    camera, scene = straight_camera(8), random_discs(4, 0.1, torch.float32)
    plain = Gaussians(scene.means, scene.quats, scene.scales, scene.opacities, scene.colors)
    with pytest.raises(InputError, match="expected discs"):
        rasterizer.rasterize(plain, camera, torch.ones(3))
    broken = dataclasses.replace(scene, colors=scene.colors * float("nan"))
    with pytest.raises(InputError, match=r"gaussians\.colors"):
        rasterizer.rasterize(broken, camera, torch.ones(3))


def test_the_gaussian_it_resembles_has_the_second_moment_of_a_disc() -> None:
    x = torch.linspace(-1, 1, 401, dtype=torch.float64)
    alpha = (1 - x[:, None].square() - x[None].square()).clamp_min(0)
    moment = (alpha * x.square()).sum() / alpha.sum()
    assert torch.isclose(torch.tensor(similar_scale(0.02, 0.5)).double(), 0.01 * moment.sqrt(), rtol=1e-4)


def test_a_method_may_bring_its_renderer() -> None:
    assert registry.load("ggavatar").rasterizer("cpu", "auto") is rasterize_gaussians
    assert registry.load("point_avatar").rasterizer("cpu", "auto") is rasterizer.rasterize
    camera, scene = straight_camera(16), random_discs(30, 0.2, torch.float32)
    moved = dataclasses.replace(scene, means=scene.means + torch.tensor([0.0, 0.0, 1.0]))
    slow = registry.load("point_avatar").rasterizer("cpu", "reference")(moved, camera, torch.ones(3))
    assert torch.allclose(slow.image, rasterizer.rasterize(moved, camera, torch.ones(3)).image, atol=1e-5)
