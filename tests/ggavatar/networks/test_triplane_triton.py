"""The tri-plane's Triton kernels, interpreted, against the torch twin in float64; compiled without spilling."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.networks.fields import Box, HashTriplane, HashTriplaneConfig, lookup_in_torch
from tests.support.kernel_compiler import recorded_launches
from tests.support.triton_kernels import interpreted

pytestmark = interpreted
SMALL = HashTriplaneConfig(levels=5, features=2, base=4, finest=64, log2_size=8)
"""Three dense and two hashed levels."""


@pytest.fixture
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU tensors take the way of those on CUDA."""
    monkeypatch.setattr(HashTriplane, "compiled_at", lambda *_: False)
    monkeypatch.setattr(device_kernels, "run_on", lambda *_: True)


def looked_up(config: HashTriplaneConfig, x: Tensor, upstream_of: Tensor) -> tuple[HashTriplane, Tensor, Tensor]:
    """A field with large entries, its features at `x`, and the gradient of its tables for `upstream_of`[:, :width]."""
    field = HashTriplane(config, Box((0.1, -0.2, 0.3), 1.6), torch.Generator().manual_seed(1))
    torch.nn.init.normal_(field.tables, generator=torch.Generator().manual_seed(2))
    features = field(x)
    features.backward(upstream_of[:, : field.width])
    assert field.tables.grad is not None
    return field, features.detach(), field.tables.grad


@pytest.mark.usefixtures("_on_this_device")
@pytest.mark.parametrize("config", [SMALL, HashTriplaneConfig(), HashTriplaneConfig(levels=1, log2_size=9)])
def test_features_and_gradient_equal_the_twin_in_float64(config: HashTriplaneConfig) -> None:
    """Positions reach beyond the box, where they are clamped to its surface; some rows have no gradient."""
    generator = torch.Generator().manual_seed(3)
    x, upstream = 2.2 * torch.rand(300, 3, generator=generator) - 1.1, torch.randn(300, 72, generator=generator)
    upstream[::7] = 0
    field, features, gradient = looked_up(config, x, upstream)
    tables = field.tables.detach().double().requires_grad_()
    expected = lookup_in_torch(field.box.normalize(x).double(), tables, field.levels)
    expected.backward(upstream[:, : field.width].double())
    assert tables.grad is not None
    # The position within a cell is rounded to float32 at `finest` cells.
    assert (features - expected).norm() / expected.norm() < 2e-5
    assert (gradient - tables.grad).norm() / tables.grad.norm() < 2e-5


@pytest.mark.usefixtures("_on_this_device")
def test_positions_that_are_not_numbers_are_looked_up_in_a_corner() -> None:
    x = torch.tensor([[float("nan")] * 3, [-5.0, -5.0, -5.0], [5.0, 5.0, 5.0], [float("inf")] * 3])
    _, features, _ = looked_up(SMALL, x, torch.ones(4, 72))
    assert torch.equal(features[0], features[1]) and torch.equal(features[2], features[3])
    assert not torch.equal(features[0], features[2])


@pytest.mark.usefixtures("_on_this_device")
def test_kernels_compile_without_spilling(registers_of: Callable[..., dict[str, int]]) -> None:
    with recorded_launches() as launches:
        looked_up(HashTriplaneConfig(), torch.zeros(3, 3), torch.ones(3, 72))
    assert [launch.name for launch in launches] == ["look_up_points", "spread_gradient"]
    assert max(registers_of(launches).values()) <= 64
