"""The Triton rasterizer, interpreted, against float64 autograd of the reference.

Also covers `ggavatar/render/triton/drawing.py`, `ggavatar/render/triton/geometry.py`,
`ggavatar/render/triton/gradient.py`, `ggavatar/render/triton/harmonics.py`, `ggavatar/render/triton/layout.py`,
`ggavatar/render/triton/projection.py`, `ggavatar/render/triton/stages.py`, `ggavatar/render/triton/tile_gradient.py`,
`ggavatar/render/triton/tiles.py`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from ggavatar.core import Camera, Gaussians, Rasterizer
from ggavatar.errors import InputError
from ggavatar.render import reference
from tests.support.render_scenes import FIELDS, gradients, random_camera, random_gaussians, relative_error
from tests.support.triton_kernels import interpreted

pytestmark = interpreted
WHITE = torch.ones(3)


def tile_rasterizer() -> Rasterizer:
    """A new rasterizer; triton is imported no sooner than a test runs."""
    from ggavatar.render.triton.rasterizer import TileRasterizer

    return TileRasterizer()


def crowd(coefficients: int, degree: int | None, size: float) -> tuple[Camera, Gaussians]:
    """Sixty Gaussians, every fifth one opaque enough for the limit of alpha, in an image of nine tiles."""
    cloud = random_gaussians(60, coefficients, torch.float64, seed=coefficients, size=size, degree=degree, spread=0.4)
    opacities = torch.where(torch.arange(60) % 5 == 0, 0.999, cloud.opacities)
    return random_camera(41, 33, torch.float64, focal=36.0), dataclasses.replace(cloud, opacities=opacities)


@pytest.mark.parametrize(
    ("coefficients", "degree", "size"),
    [
        (0, None, 0.03),
        (0, None, 0.6),
        (1, None, 0.12),
        (4, None, 0.12),
        (9, None, 0.6),
        (16, None, 0.12),
        (16, 1, 0.03),
    ],
)
def test_rendering_and_gradients_equal_float64_autograd(coefficients: int, degree: int | None, size: float) -> None:
    camera, cloud = crowd(coefficients, degree, size)
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    found, fast = gradients(tile_rasterizer(), cloud, camera)
    assert (expected.radii > 0).sum() > 20
    for name in ("image", "alpha", "depth", "means2d", "radii"):
        torch.testing.assert_close(getattr(found, name).double(), getattr(expected, name), atol=3e-5, rtol=2e-5)
    assert slow.keys() == fast.keys() and {"pose", "background", "means2d"} <= slow.keys()
    errors = {name: relative_error(fast[name], slow[name]) for name in slow}
    assert max(errors.values()) < 1e-4, errors


def test_scenes_reach_the_special_cases() -> None:
    """The comparison above means nothing if no alpha is limited, no pixel finishes and no Jacobian is clamped."""
    camera, cloud = crowd(0, None, 0.6)
    drawn = reference.rasterize(cloud, camera, torch.ones(3, dtype=torch.float64))
    assert drawn.alpha.max() > 0.9998
    shown = drawn.radii > 0
    outside = (drawn.means2d[:, 0] < -0.15 * 41) | (drawn.means2d[:, 0] > 1.15 * 41)
    assert (shown & outside).any() and not shown.all()


@pytest.mark.parametrize("size", [(1, 1), (70, 1), (1, 35), (16, 16), (17, 15)])
@pytest.mark.parametrize("count", [1, 130])
def test_any_image_size_and_number_of_gaussians(size: tuple[int, int], count: int) -> None:
    camera, cloud = random_camera(*size, torch.float64, focal=40.0), random_gaussians(count, 4, torch.float64, size=0.3)
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    found, fast = gradients(tile_rasterizer(), cloud, camera)
    torch.testing.assert_close(found.image.double(), expected.image, atol=3e-5, rtol=1e-5)
    assert found.image.shape == (size[1], size[0], 3) and found.image.is_contiguous()
    for name, value in slow.items():
        assert relative_error(fast[name], value) < 1e-4 or value.norm() < 1e-6, name


def test_no_gaussians_show_the_background() -> None:
    drawn = tile_rasterizer()(random_gaussians(0, 16, torch.float32), random_camera(20, 9, torch.float32), 0.5 * WHITE)
    assert torch.equal(drawn.image, torch.full((9, 20, 3), 0.5)) and drawn.radii.shape == (0,)


EXTREMES = {
    "behind": {"means": torch.tensor([0.1, 0.2, 5.0]).repeat(20, 1)},
    "at-the-eye": {"means": torch.tensor([0.1, 0.2, 1.0]).repeat(20, 1)},
    "huge": {"scales": torch.full((20, 3), 1e3)},
    "vast": {"scales": torch.full((20, 3), 1e12)},
    "flat": {"scales": torch.zeros(20, 3)},
    "needle": {"scales": torch.tensor([1e3, 1e-8, 1.0]).repeat(20, 1)},
    "clear": {"opacities": torch.zeros(20)},
    "opaque": {"opacities": torch.ones(20)},
    "zero": {"quats": torch.zeros(20, 4)},
    "long": {"quats": torch.full((20, 4), 1e25)},
}


@pytest.mark.filterwarnings("ignore:(overflow|invalid value|divide by zero) encountered:RuntimeWarning")
@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_give_finite_numbers(name: str) -> None:
    cloud = dataclasses.replace(random_gaussians(20, 4, torch.float32), **EXTREMES[name])
    drawn, found = gradients(tile_rasterizer(), cloud, random_camera(20, 17, torch.float32))
    for key, value in (found | {"image": drawn.image, "alpha": drawn.alpha, "depth": drawn.depth}).items():
        assert value.isfinite().all(), key
    assert drawn.alpha.min() >= 0 and drawn.alpha.max() <= 1


def test_needles_keep_their_width_in_float32() -> None:
    """A Gaussian 10⁵ times longer than wide: a conic, or a determinant by subtraction, would have no correct digit."""
    camera, cloud = random_camera(48, 40, torch.float64), random_gaussians(20, 0, torch.float64)
    cloud = dataclasses.replace(cloud, scales=torch.tensor([30.0, 3e-4, 3e-4], dtype=torch.float64).repeat(20, 1))
    expected = reference.rasterize(cloud, camera, torch.ones(3, dtype=torch.float64))
    found = tile_rasterizer()(cloud, camera, WHITE)
    assert expected.alpha.mean() > 0.05
    assert (found.image - expected.image).abs().mean() < 1e-3


def test_equal_depths_are_drawn_in_order_of_rows() -> None:
    cloud = Gaussians(
        torch.zeros(2, 3), torch.ones(2, 4), torch.full((2, 3), 0.1), torch.tensor([0.9, 0.9]), torch.eye(3)[:2]
    )
    image = tile_rasterizer()(cloud, random_camera(20, 20, torch.float32), torch.zeros(3)).image
    red, green = image[image.sum(-1) == image.sum(-1).max()][0, :2]
    assert red > 0.85 and 0.05 < green < 0.12


def test_results_repeat_bit_for_bit() -> None:
    camera, cloud = crowd(16, None, 0.12)
    first, second = (gradients(tile_rasterizer(), cloud, camera) for _ in range(2))
    assert torch.equal(first[0].image, second[0].image)
    assert all(torch.equal(first[1][name], second[1][name]) for name in first[1])


@pytest.mark.parametrize(("field", "row"), [(name, 4) for name in FIELDS] + [("world_to_camera", 0), ("background", 1)])
@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_nan_and_infinity_are_named_at_a_later_call(field: str, row: int) -> None:
    """The first rendering cannot wait for the device; the next one that knows raises."""
    cloud, camera = random_gaussians(5, 4, torch.float32), random_camera(20, 17, torch.float32)
    background, draw = torch.ones(3), tile_rasterizer()
    broken = {"world_to_camera": camera.world_to_camera, "background": background}.get(field)
    (getattr(cloud, field) if broken is None else broken)[row].view(-1)[0] = math.inf if row == 4 else math.nan
    draw(cloud, camera, background)
    with pytest.raises(
        InputError,
        match=rf"^\w+\.{field}: expected finite numbers" if field != "background" else "^background: expected",
    ):
        draw(random_gaussians(5, 4, torch.float32), random_camera(20, 17, torch.float32), WHITE)
    draw(random_gaussians(5, 4, torch.float32), random_camera(20, 17, torch.float32), WHITE)


def test_what_cannot_be_rendered_is_refused() -> None:
    cloud, camera = random_gaussians(5, 4, torch.float32), random_camera(20, 20, torch.float32)
    learned = dataclasses.replace(camera, intrinsics=camera.intrinsics.clone().requires_grad_())
    with pytest.raises(InputError, match="triton rasterizer computes no gradient of intrinsics"):
        tile_rasterizer()(cloud, learned, WHITE)
    with pytest.raises(ValueError, match="at least 1"):
        tile_rasterizer()(cloud, dataclasses.replace(camera, width=0), WHITE)


def test_other_layouts_and_dtypes_are_converted() -> None:
    cloud, camera = random_gaussians(30, 9, torch.float64), random_camera(24, 18, torch.float64)
    plain = tile_rasterizer()(Gaussians(*(getattr(cloud, name).float() for name in FIELDS)), camera, WHITE).image
    strided = {name: getattr(cloud, name).repeat_interleave(2, 0)[::2].requires_grad_() for name in FIELDS}
    drawn = tile_rasterizer()(Gaussians(**strided), camera, WHITE)
    drawn.image.backward(torch.randn(3, 18, 24).permute(1, 2, 0))
    assert torch.equal(drawn.image, plain)
    for leaf in strided.values():
        assert leaf.grad is not None and leaf.grad.dtype == torch.float64 and leaf.grad.abs().sum() > 0


def test_no_gradient_is_recorded_without_need() -> None:
    cloud, camera = random_gaussians(20, 4, torch.float32), random_camera(20, 17, torch.float32)
    with torch.no_grad():
        drawn = tile_rasterizer()(cloud, camera, WHITE)
    assert not drawn.image.requires_grad and not drawn.means2d.requires_grad and not drawn.radii.requires_grad


@pytest.mark.parametrize("given", ["image", "alpha", "depth"])
def test_gradients_of_one_output_only(given: str) -> None:
    camera, cloud = crowd(4, None, 0.12)
    found: list[Tensor] = []
    for draw, dtype in ((reference.rasterize, torch.float64), (tile_rasterizer(), torch.float32)):
        means = cloud.means.to(dtype, copy=True).requires_grad_()
        moved = Gaussians(means, *(getattr(cloud, name).to(dtype) for name in FIELDS[1:]))
        view = Camera(camera.intrinsics.to(dtype), camera.world_to_camera.to(dtype), camera.width, camera.height)
        getattr(draw(moved, view, torch.ones(3, dtype=dtype)), given).square().sum().backward()
        assert means.grad is not None
        found.append(means.grad)
    assert relative_error(found[1], found[0]) < 1e-4


class Operations(TorchDispatchMode):
    """Records torch's operations that do something on a device."""

    NOTHING = (
        "empty",
        "new_empty",
        "view",
        "detach",
        "select",
        "alias",
        "slice",
        "reshape",
        "expand",
        "as_strided",
        "lift",
    )

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func._schema.name.split("::")[1]
        if not name.strip("_").startswith(self.NOTHING):
            self.names.append(name)
        return func(*args, **(kwargs or {}))


WAITING = ("_local_scalar_dense", "nonzero", "masked_select", "index", "index_put_", "equal", "is_nonzero", "_unique2")
"""Operations for which the host waits for the device; `index` does with a mask or a list."""


def test_nothing_waits_for_the_device_and_launches_are_few() -> None:
    from tests.support.kernel_compiler import recorded_launches

    cloud, camera, draw = (
        random_gaussians(20, 16, torch.float32),
        random_camera(20, 17, torch.float32),
        tile_rasterizer(),
    )
    leaf = cloud.means.requires_grad_()
    with recorded_launches() as forward, Operations() as drawing:
        image = draw(cloud, camera, WHITE).image
    upstream = torch.rand(17, 20, 3)
    with recorded_launches() as backward, Operations() as differentiating:
        image.backward(upstream)
    assert leaf.grad is not None
    assert not {*WAITING} & {*drawing.names, *differentiating.names}
    assert [launch.name for launch in forward] == ["project_gaussians", "list_pairs", "finish_lists", "draw_tiles"]
    assert sorted(drawing.names) == ["cumsum", "index_select", "sort", "sort", "zeros"]
    assert [launch.name for launch in backward] == ["differentiate_tiles", "differentiate_gaussians", "finish_pose"]
    assert differentiating.names == ["zero_"]


def test_too_many_pairs_cost_time_and_no_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """With memory for few of its pairs a rendering is the same; the next one has memory for all."""
    from ggavatar.render.triton import capacity

    monkeypatch.setattr(capacity, "STEP", 8)
    monkeypatch.setattr(capacity, "FIRST_GUESS", 1.0)
    camera, cloud = crowd(4, None, 0.12)
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    draw, capacities = tile_rasterizer(), []
    for _ in range(2):
        found, fast = gradients(draw, cloud, camera)
        torch.testing.assert_close(found.image.double(), expected.image, atol=3e-5, rtol=2e-5)
        torch.testing.assert_close(found.depth.double(), expected.depth, atol=3e-5, rtol=2e-5)
        assert max(relative_error(fast[name], slow[name]) for name in slow) < 1e-4
        (report,) = draw._memory._reports.arrived()
        draw._memory._capacity.learn(report)
        capacities.append(report.capacity)
    assert capacities[0] == 64 < report.pairs <= capacities[1]
