"""The reference rasterizer against closed forms, finite differences and gsplat's own torch projection."""

from __future__ import annotations

import math

import pytest
import torch

from ggavatar.core import Camera, Gaussians
from ggavatar.errors import InputError
from ggavatar.render import reference
from ggavatar.render.harmonics import C0, sh_basis, used_degree
from ggavatar.render.projection import project
from tests.support.render_scenes import random_camera, random_gaussians

DOUBLE = torch.float64
BLACK = torch.zeros(3, dtype=DOUBLE)


def frontal(size: int = 33, focal: float = 40.0) -> Camera:
    """A camera at the origin that looks along +z, its principal point on the middle pixel's center."""
    half = size / 2
    intrinsics = torch.tensor([[focal, 0, half], [0, focal, half], [0, 0, 1]], dtype=DOUBLE)
    return Camera(intrinsics, torch.eye(4, dtype=DOUBLE), size, size)


def spheres(depths: list[float], scales: list[float], opacities: list[float], colors: list[list[float]]) -> Gaussians:
    """Round Gaussians on the optical axis."""
    count = len(depths)
    means = torch.zeros(count, 3, dtype=DOUBLE)
    means[:, 2] = torch.tensor(depths, dtype=DOUBLE)
    quats = torch.tensor([[1.0, 0, 0, 0]], dtype=DOUBLE).repeat(count, 1)
    sizes = torch.tensor(scales, dtype=DOUBLE)[:, None].repeat(1, 3)
    return Gaussians(means, quats, sizes, torch.tensor(opacities, dtype=DOUBLE), torch.tensor(colors, dtype=DOUBLE))


def test_one_gaussian_in_closed_form() -> None:
    drawn = reference.rasterize(spheres([2.0], [0.2], [0.8], [[0.2, 0.5, 0.9]]), frontal(), BLACK)
    variance = (40 * 0.2 / 2) ** 2 + 0.3
    offset = torch.arange(33, dtype=DOUBLE) - 16
    square = offset[None, :] ** 2 + offset[:, None] ** 2
    alpha = 0.8 * torch.exp(-square / (2 * variance))
    alpha = torch.where(alpha >= 1 / 255, alpha, 0)
    torch.testing.assert_close(drawn.alpha[..., 0], alpha)
    torch.testing.assert_close(drawn.image, alpha[..., None] * torch.tensor([0.2, 0.5, 0.9], dtype=DOUBLE))
    torch.testing.assert_close(drawn.depth[..., 0], 2 * alpha)
    torch.testing.assert_close(drawn.means2d[0], torch.tensor([16.5, 16.5], dtype=DOUBLE))
    assert drawn.radii[0].item() == pytest.approx(math.sqrt(2 * math.log(255 * 0.8) * variance))


def test_two_gaussians_are_blended_by_depth_not_by_row() -> None:
    pair = spheres([3.0, 2.0], [0.3, 0.1], [0.9, 0.5], [[0, 1, 0], [1, 0, 0]])
    background = torch.tensor([0.0, 0.0, 1.0], dtype=DOUBLE)
    drawn = reference.rasterize(pair, frontal(), background)
    expected = torch.tensor([0.5, 0.5 * 0.9, 0.5 * 0.1], dtype=DOUBLE)
    torch.testing.assert_close(drawn.image[16, 16], expected)
    assert drawn.depth[16, 16].item() == pytest.approx(0.5 * 2 + 0.45 * 3)


def test_alpha_stops_at_the_limit_and_finished_pixels_take_no_more() -> None:
    opaque = spheres([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    drawn = reference.rasterize(opaque, frontal(), BLACK)
    # 0.01 · 0.01 leaves 1e-4 of the light, above the limit or not by rounding; the third would leave 1e-6.
    assert drawn.image[16, 16, 0].item() == pytest.approx(0.99)
    assert drawn.image[16, 16, 2].item() == 0


@pytest.mark.parametrize("coefficients", [0, 1, 4, 9, 16])
def test_gradcheck(coefficients: int) -> None:
    count, camera = 4, random_camera(7, 6, DOUBLE, focal=8.0)
    cloud = random_gaussians(count, coefficients, DOUBLE, seed=3, size=0.3)
    inputs = [cloud.means * 0.5, cloud.quats, cloud.scales + 0.2, cloud.opacities * 0.5 + 0.3, cloud.colors]
    inputs += [camera.world_to_camera, camera.intrinsics, torch.tensor([0.2, 0.5, 0.7], dtype=DOUBLE)]

    def draw(*tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        view = Camera(tensors[6], tensors[5], 7, 6)
        drawn = reference.rasterize(Gaussians(*tensors[:5]), view, tensors[7])
        return drawn.image, drawn.alpha, drawn.depth

    leaves = tuple(tensor.clone().requires_grad_() for tensor in inputs)
    assert (draw(*leaves)[1] > 0.05).any()
    assert torch.autograd.gradcheck(draw, leaves, eps=1e-7, atol=1e-5, fast_mode=True)


def test_means2d_gradient_is_the_change_per_pixel_of_shift() -> None:
    camera, cloud = random_camera(20, 16, DOUBLE), random_gaussians(1, 0, DOUBLE, size=0.2)
    cloud = Gaussians(
        torch.zeros(1, 3, dtype=DOUBLE, requires_grad=True), cloud.quats, cloud.scales, cloud.opacities, cloud.colors
    )
    drawn = reference.rasterize(cloud, camera, BLACK)
    weights = torch.arange(20, dtype=DOUBLE)[None, :, None] * drawn.image.detach().new_ones(16, 1, 3)
    (drawn.image * weights).sum().backward()
    shift = 1e-5
    moved = Camera(camera.intrinsics.clone(), camera.world_to_camera, 20, 16)
    moved.intrinsics[0, 2] += shift
    far = (reference.rasterize(cloud, moved, BLACK).image * weights).sum() - (drawn.image * weights).sum()
    assert drawn.means2d.grad is not None
    # Moving the principal point moves the center and nothing else here.
    assert drawn.means2d.grad[0, 0].item() == pytest.approx(far.item() / shift, rel=1e-3)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_projection_equals_gsplats_torch_code() -> None:
    torch_code = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is an optional extra")
    camera, cloud = random_camera(50, 41, DOUBLE), random_gaussians(500, 0, DOUBLE, size=0.2, spread=0.8)
    covariances, _ = torch_code._quat_scale_to_covar_preci(cloud.quats, cloud.scales, True, False)
    arguments = cloud.means, covariances, camera.world_to_camera[None], camera.intrinsics[None], 50, 41
    radii, means2d, depths, conics, _ = torch_code._fully_fused_projection(*arguments)
    found = project(cloud, camera)
    assert (depths[0] < 0).any() and (radii[0, :, 0] > 0).sum() > 100
    front = depths[0] > 0.01
    torch.testing.assert_close(found.means2d, means2d[0])
    torch.testing.assert_close(found.depths, depths[0])
    torch.testing.assert_close(found.conics[front], conics[0][front], rtol=1e-9, atol=1e-12)


def test_harmonics_are_orthonormal() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.nn.functional.normalize(torch.randn(200_000, 3, generator=generator, dtype=DOUBLE), dim=-1)
    basis = sh_basis(points, 3)
    gram = basis.T @ basis * (4 * math.pi / len(points))
    torch.testing.assert_close(gram, torch.eye(16, dtype=DOUBLE), atol=0.03, rtol=0)
    assert basis[0, 0].item() == pytest.approx(C0)


@pytest.mark.parametrize(("held", "wanted"), [(2, None), (25, None), (4, 2), (4, -1)])
def test_impossible_degrees_are_refused(held: int, wanted: int | None) -> None:
    with pytest.raises(ValueError, match="expected"):
        used_degree(held, wanted)


def test_nothing_visible_shows_the_background() -> None:
    camera, cloud = frontal(9), spheres([-1.0], [0.1], [0.9], [[1, 1, 1]])
    background = torch.tensor([0.1, 0.2, 0.3], dtype=DOUBLE)
    drawn = reference.rasterize(cloud, camera, background)
    torch.testing.assert_close(drawn.image, background.expand(9, 9, 3))
    assert drawn.radii.tolist() == [0]


@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "colors"])
def test_nan_is_refused_by_name(field: str) -> None:
    cloud = spheres([2.0], [0.1], [0.9], [[1, 1, 1]])
    getattr(cloud, field).view(-1)[0] = math.nan
    with pytest.raises(InputError, match=f"gaussians.{field}: expected finite"):
        reference.rasterize(cloud, frontal(), BLACK)
