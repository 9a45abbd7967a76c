"""The compiled rasterizer against float64 autograd of the reference.

Also covers `ggavatar/jit/padding.py`, `ggavatar/render/checks.py`, `ggavatar/render/constants.py`,
`ggavatar/render/cpu/backward.py`, `ggavatar/render/cpu/binning.py`, `ggavatar/render/cpu/blending.py`,
`ggavatar/render/cpu/forward.py`, `ggavatar/render/cpu/gradient.py`, `ggavatar/render/cpu/harmonics.py`,
`ggavatar/render/cpu/layout.py`, `ggavatar/render/cpu/projection.py`, `ggavatar/render/cpu/stages.py`.
"""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch

from ggavatar.core import Gaussians
from ggavatar.errors import InputError
from ggavatar.render import reference
from ggavatar.render.cpu import rasterizer
from tests.support.render_scenes import FIELDS, gradients, random_camera, random_gaussians, relative_error

WHITE = torch.ones(3)


@pytest.mark.parametrize(
    ("coefficients", "degree"), [(0, None), (1, None), (4, None), (9, None), (16, None), (16, 0), (16, 1), (16, 2)]
)
@pytest.mark.parametrize("size", [0.03, 0.12, 0.6])
def test_rendering_and_gradients_equal_float64_autograd(coefficients: int, degree: int | None, size: float) -> None:
    """Small, middle-sized and huge Gaussians; the last kind covers clamped Jacobians and pixels that finish early."""
    camera = random_camera(67, 53, torch.float64)
    cloud = random_gaussians(130, coefficients, torch.float64, seed=coefficients, size=size, degree=degree, spread=0.4)
    cloud = dataclasses.replace(cloud, opacities=torch.where(torch.arange(130) % 5 == 0, 0.999, cloud.opacities))
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    found, fast = gradients(rasterizer.rasterize, cloud, camera)
    assert (expected.radii > 0).sum() > 30
    for name in ("image", "alpha", "depth", "means2d", "radii"):
        torch.testing.assert_close(getattr(found, name).double(), getattr(expected, name), atol=3e-5, rtol=2e-5)
    assert slow.keys() == fast.keys()
    errors = {name: relative_error(fast[name], slow[name]) for name in slow}
    assert max(errors.values()) < 1e-4, errors


def test_scenes_reach_the_special_cases() -> None:
    """The comparison above means nothing if no alpha is clamped, no pixel finishes and no Jacobian is clamped."""
    camera = random_camera(67, 53, torch.float64)
    cloud = random_gaussians(130, 0, torch.float64, size=0.6, spread=0.4)
    drawn = reference.rasterize(cloud, camera, torch.ones(3, dtype=torch.float64))
    assert drawn.alpha.max() > 0.999
    shown = drawn.radii > 0
    outside = (drawn.means2d[:, 0] < -0.15 * 67) | (drawn.means2d[:, 0] > 1.15 * 67)
    assert (shown & outside).any()
    assert ((drawn.means2d - torch.tensor([33.0, 26.0])).abs().amax(1)[shown] < 30).any()


@pytest.mark.parametrize("size", [(1, 1), (4096, 1), (1, 300), (16, 16), (17, 15), (64, 31)])
def test_any_image_size(size: tuple[int, int]) -> None:
    camera, cloud = random_camera(*size, torch.float64, focal=40.0), random_gaussians(40, 4, torch.float64, size=0.3)
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    found, fast = gradients(rasterizer.rasterize, cloud, camera)
    torch.testing.assert_close(found.image.double(), expected.image, atol=3e-5, rtol=1e-5)
    assert found.image.shape == (size[1], size[0], 3) and found.image.is_contiguous()
    for name, value in slow.items():
        assert relative_error(fast[name], value) < 1e-4 or value.norm() < 1e-6, name


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 33])
def test_any_number_of_gaussians(count: int) -> None:
    camera, cloud = random_camera(20, 20, torch.float64), random_gaussians(count, 16, torch.float64)
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    found, fast = gradients(rasterizer.rasterize, cloud, camera)
    torch.testing.assert_close(found.image.double(), expected.image, atol=1e-5, rtol=1e-5)
    assert found.radii.shape == (count,)
    for name in set(slow) & set(fast):
        torch.testing.assert_close(fast[name], slow[name], atol=1e-4, rtol=1e-3)


def draw_variant(cloud: Gaussians, **changes: torch.Tensor) -> dict[str, torch.Tensor]:
    """Gradients and image of a scene with some tensors replaced."""
    drawn, found = gradients(
        rasterizer.rasterize, dataclasses.replace(cloud, **changes), random_camera(48, 40, torch.float32)
    )
    return found | {"image": drawn.image.detach(), "alpha": drawn.alpha.detach(), "depth": drawn.depth.detach()}


@pytest.mark.parametrize(
    "changes",
    [
        {"means": torch.tensor([0.1, 0.2, 5.0]).repeat(50, 1)},
        {"means": torch.tensor([100.0, 0.0, 0.0]).repeat(50, 1)},
        {"means": torch.tensor([0.1, 0.2, 1.0]).repeat(50, 1)},
        {"scales": torch.full((50, 3), 1e3)},
        {"scales": torch.full((50, 3), 1e12)},
        {"scales": torch.full((50, 3), 1e-12)},
        {"scales": torch.zeros(50, 3)},
        {"scales": torch.tensor([1e3, 1e-8, 1.0]).repeat(50, 1)},
        {"opacities": torch.zeros(50)},
        {"opacities": torch.ones(50)},
        {"quats": torch.zeros(50, 4)},
        {"quats": torch.full((50, 4), 1e-25)},
        {"quats": torch.full((50, 4), 1e25)},
    ],
    ids=[
        "behind",
        "off-screen",
        "at-the-eye",
        "huge",
        "vast",
        "tiny",
        "flat",
        "needle",
        "clear",
        "opaque",
        "zero",
        "short",
        "long",
    ],
)
def test_extremes_give_finite_numbers(changes: dict[str, torch.Tensor]) -> None:
    found = draw_variant(random_gaussians(50, 16, torch.float32), **changes)
    for name, value in found.items():
        assert value.isfinite().all(), name
    assert found["alpha"].min() >= 0 and found["alpha"].max() <= 1


def test_needles_keep_their_width_in_float32() -> None:
    """A Gaussian 10⁵ times longer than wide: the determinant by subtraction would have no correct digit."""
    camera = random_camera(48, 40, torch.float64)
    cloud = random_gaussians(20, 0, torch.float64)
    cloud = dataclasses.replace(cloud, scales=torch.tensor([30.0, 3e-4, 3e-4], dtype=torch.float64).repeat(20, 1))
    expected, _ = gradients(reference.rasterize, cloud, camera, torch.float64)
    found, _ = gradients(rasterizer.rasterize, cloud, camera)
    assert expected.alpha.mean() > 0.05
    assert (found.image - expected.image).abs().mean() < 1e-3


def test_many_gaussians_on_one_pixel() -> None:
    count = 100_000
    generator = torch.Generator().manual_seed(0)
    means = torch.zeros(count, 3)
    means[:, 2] = torch.rand(count, generator=generator) * 0.01
    cloud = Gaussians(
        means, torch.ones(count, 4), torch.full((count, 3), 1e-4), torch.full((count,), 0.01), torch.rand(count, 3)
    )
    camera = random_camera(30, 30, torch.float32)
    drawn, found = gradients(rasterizer.rasterize, cloud, camera)
    assert drawn.alpha.max() > 0.999
    assert found["opacities"].isfinite().all()


def test_equal_depths_are_drawn_in_order_of_rows() -> None:
    cloud = Gaussians(
        torch.zeros(2, 3), torch.ones(2, 4), torch.full((2, 3), 0.1), torch.tensor([0.9, 0.9]), torch.eye(3)[:2]
    )
    camera = random_camera(20, 20, torch.float32)
    image = rasterizer.rasterize(cloud, camera, torch.zeros(3)).image
    red, green = image[image.sum(-1) == image.sum(-1).max()][0, :2]
    assert red > 0.85 and 0.05 < green < 0.12


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_are_refused_by_name(field: str, value: float) -> None:
    cloud = random_gaussians(2100, 4, torch.float32)
    getattr(cloud, field)[2077].view(-1)[0] = value
    with pytest.raises(InputError, match=rf"gaussians\.{field}: .*1 of 2100 rows \(first: 2077\)"):
        rasterizer.rasterize(cloud, random_camera(20, 20, torch.float32), WHITE)


def test_a_camera_with_nan_and_wrong_shapes_are_refused() -> None:
    cloud, camera = random_gaussians(5, 4, torch.float32), random_camera(20, 20, torch.float32)
    broken = dataclasses.replace(camera, world_to_camera=torch.full((4, 4), math.nan))
    with pytest.raises(InputError, match=r"camera\.world_to_camera: expected finite"):
        rasterizer.rasterize(cloud, broken, WHITE)
    with pytest.raises(InputError, match="intrinsics"):
        rasterizer.rasterize(
            cloud, dataclasses.replace(camera, intrinsics=camera.intrinsics.clone().requires_grad_()), WHITE
        )
    with pytest.raises(ValueError, match="at least 1"):
        rasterizer.rasterize(cloud, dataclasses.replace(camera, width=0), WHITE)


def test_other_layouts_and_dtypes_are_converted() -> None:
    cloud, camera = random_gaussians(60, 9, torch.float64), random_camera(40, 30, torch.float64)
    plain = rasterizer.rasterize(Gaussians(*(getattr(cloud, name).float() for name in FIELDS)), camera, WHITE).image
    strided = {name: getattr(cloud, name).repeat_interleave(2, 0)[::2] for name in FIELDS}
    strided["colors"] = cloud.colors.permute(2, 1, 0).contiguous().permute(2, 1, 0)
    leaves = {name: tensor.requires_grad_() for name, tensor in strided.items()}
    assert not leaves["colors"].is_contiguous() and not leaves["means"].is_contiguous()
    drawn = rasterizer.rasterize(Gaussians(**leaves), camera, WHITE)
    drawn.image.sum().backward()
    assert torch.equal(drawn.image, plain)
    for leaf in leaves.values():
        assert leaf.grad is not None and leaf.grad.dtype == torch.float64 and leaf.grad.shape == leaf.shape


def test_gradients_that_arrive_strided_or_not_at_all() -> None:
    cloud, camera = random_gaussians(60, 4, torch.float32), random_camera(40, 30, torch.float32)
    cloud.means.requires_grad_()
    incoming = torch.randn(3, 30, 40)
    rasterizer.rasterize(cloud, camera, WHITE).image.backward(incoming.permute(1, 2, 0))
    first = cloud.means.grad
    cloud.means.grad = None
    rasterizer.rasterize(cloud, camera, WHITE).image.backward(incoming.permute(1, 2, 0).contiguous())
    assert first is not None and torch.equal(first, cloud.means.grad)
    cloud.means.grad = None
    rasterizer.rasterize(cloud, camera, WHITE).alpha.sum().backward()
    assert cloud.means.grad is not None and cloud.means.grad.abs().sum() > 0


def test_no_gradient_is_recorded_without_need() -> None:
    cloud, camera = random_gaussians(20, 4, torch.float32), random_camera(40, 30, torch.float32)
    with torch.no_grad():
        drawn = rasterizer.rasterize(cloud, camera, WHITE)
    assert not drawn.image.requires_grad and not drawn.means2d.requires_grad
    assert not drawn.radii.requires_grad
