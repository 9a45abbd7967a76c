"""The hash tri-plane against its layout, interpolation, twin and float64 autograd; Fourier features in closed form.

Also covers `ggavatar/jit/pairs.py`, `ggavatar/networks/triplane_kernel.py`.
"""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from ggavatar.networks.fields import (
    Box,
    FourierFeatures,
    HashTriplane,
    HashTriplaneConfig,
    levels_of,
    lookup_in_torch,
)

SMALL = HashTriplaneConfig(levels=5, features=2, base=4, finest=64, log2_size=8)
"""Three dense and two hashed levels."""


def field(config: HashTriplaneConfig = SMALL, box: Box | None = None) -> HashTriplane:
    made = HashTriplane(config, box or Box((0.0, 0.0, 0.0), 2.0), torch.Generator().manual_seed(1))
    torch.nn.init.normal_(made.tables, generator=torch.Generator().manual_seed(2))
    return made


def points(count: int, reach: float = 1.0) -> Tensor:
    return (2 * torch.rand(count, 3, generator=torch.Generator().manual_seed(3)) - 1) * reach


def test_default_layout_is_the_documented_one() -> None:
    """docs/paper.md, A9: 72 features, 1.06 million parameters, 4 of 12 levels hashed, 16 to 512 cells."""
    made = HashTriplane(HashTriplaneConfig(), Box(), torch.Generator().manual_seed(0))
    assert made.width == 72 and made.tables.numel() == 1_064_832
    assert sum(level.hashed for level in made.levels) == 4
    assert (made.levels[0].side, made.levels[-1].side) == (17, 513)
    assert all(level.size % 8 == 0 for level in made.levels)
    assert 0.9e-4 < made.tables.abs().max() <= 1e-4 and abs(made.tables.mean()) < 1e-6


def test_tables_follow_the_generator() -> None:
    same = [HashTriplane(SMALL, Box(), torch.Generator().manual_seed(7)).tables for _ in range(2)]
    assert torch.equal(*same)


def test_dense_level_is_bilinear_interpolation() -> None:
    """At a grid vertex the feature is that vertex's entry; between two of them it is their mean."""
    config = HashTriplaneConfig(levels=1, features=2, base=4, finest=4, log2_size=8)
    made = field(config, Box((0.5, 0.5, 0.5), 1.0))
    level = made.levels[0]
    vertex = torch.tensor([1.0, 2.0, 3.0])
    x = (vertex - 0.5) / level.scale
    for shift, weights in ((torch.zeros(3), {0: 1.0}), (torch.tensor([0.5, 0.0, 0.0]) / level.scale, {0: 0.5, 1: 0.5})):
        found = made((x + shift)[None])[0, :2]  # the plane xy
        entry = int(vertex[0] + vertex[1] * level.side)
        expected = sum((weight * made.tables[entry + step] for step, weight in weights.items()), torch.zeros(2))
        assert torch.allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("config", [SMALL, HashTriplaneConfig(levels=3, log2_size=10), HashTriplaneConfig(levels=1)])
def test_compiled_look_up_and_gradient_equal_the_twin_in_float64(config: HashTriplaneConfig) -> None:
    made, x = field(config), points(3000, 1.2)
    upstream = torch.randn(3000, made.width, generator=torch.Generator().manual_seed(4))
    features = made(x)
    features.backward(upstream)
    tables = made.tables.detach().double().requires_grad_()
    expected = lookup_in_torch(made.box.normalize(x).double(), tables, made.levels)
    expected.backward(upstream.double())
    assert made.tables.grad is not None and tables.grad is not None
    # The position within a cell is rounded to float32 at `finest` cells.
    assert (features - expected).norm() / expected.norm() < 2e-5
    assert (made.tables.grad - tables.grad).norm() / tables.grad.norm() < 2e-5


def test_gradcheck_of_the_twin_in_the_tables() -> None:
    config = HashTriplaneConfig(levels=2, features=2, base=2, finest=4, log2_size=3)
    levels = levels_of(config)
    tables = torch.randn(3 * sum(level.size for level in levels), 2, dtype=torch.float64, requires_grad=True)
    unit = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    assert torch.autograd.gradcheck(lambda values: lookup_in_torch(unit, values, levels), tables)


def test_other_feature_counts_take_the_twin() -> None:
    made = field(HashTriplaneConfig(levels=2, features=4, base=4, finest=8, log2_size=6))
    assert made(points(10)).shape == (10, 3 * 2 * 4)


def test_positions_are_keys_without_gradient() -> None:
    """docs/paper.md, A11."""
    x = points(5).requires_grad_()
    assert not FourierFeatures(Box())(x).requires_grad
    field()(x).sum().backward()
    assert x.grad is None


def test_points_outside_are_clamped_and_not_numbers_do_no_harm() -> None:
    made = field()
    outside = made(torch.tensor([[9.0, 0.1, -9.0]]))
    assert torch.equal(outside, made(torch.tensor([[1.0, 0.1, -1.0]])))
    assert made(torch.full((3, 3), math.nan)).isfinite().all()
    assert made(torch.zeros(0, 3)).shape == (0, made.width)


def test_each_plane_ignores_its_third_axis_and_sees_the_others() -> None:
    """The planes are xy, xz and yz, in this order (docs/paper.md, A9)."""
    made, x = field(), points(50)
    width = made.width // 3
    for plane, ignored in enumerate("zyx"):
        for axis, name in enumerate("xyz"):
            moved = x.clone()
            moved[:, axis] = 0.37
            columns = slice(plane * width, (plane + 1) * width)
            assert torch.equal(made(moved)[:, columns], made(x)[:, columns]) == (name == ignored)


@pytest.mark.parametrize("threads", [2, 4])
def test_same_bits_for_any_number_of_threads(threads: int) -> None:
    before, found = torch.get_num_threads(), []
    try:
        for count in (1, threads):
            torch.set_num_threads(count)
            made = field()
            features = made(points(10_000))
            features.backward(torch.randn(features.shape, generator=torch.Generator().manual_seed(6)))
            found.append((features.detach(), made.tables.grad))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found[0][0], found[1][0]) and torch.equal(found[0][1], found[1][1])


def test_box_around_points() -> None:
    """docs/paper.md, A10: 1.4 times the longest side of the bounds."""
    box = Box.around(torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.3, -0.2]]))
    assert box.center == pytest.approx((0.05, 0.15, -0.1)) and box.side == pytest.approx(0.42)
    assert torch.allclose(box.normalize(torch.tensor([[0.05, 0.15, -0.1]])), torch.full((1, 3), 0.5))


def test_fourier_features_in_closed_form() -> None:
    features = FourierFeatures(Box((0.0, 0.0, 0.0), 2.0))(torch.tensor([[0.25, 0.0, -0.5]], dtype=torch.float64))[0]
    assert features.shape == (63,)
    assert torch.allclose(features[:3], torch.tensor([0.25, 0.0, -0.5], dtype=torch.float64))
    for octave in range(10):
        block = features[3 + 6 * octave : 9 + 6 * octave]
        angles = [math.pi * 2**octave * value for value in (0.25, 0.0, -0.5)]
        expected = [math.sin(a) for a in angles] + [math.cos(a) for a in angles]
        assert torch.allclose(block, torch.tensor(expected, dtype=torch.float64), atol=1e-9)
