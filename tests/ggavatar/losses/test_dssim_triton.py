"""The image loss's Triton kernels, interpreted, against the torch twin in float64; compiled without spilling."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.losses import dssim
from ggavatar.losses.dssim import DssimTarget, ImageTerms, image_terms, image_terms_in_torch
from tests.support.kernel_compiler import recorded_launches
from tests.support.triton_kernels import interpreted

pytestmark = interpreted


@pytest.fixture(autouse=True)
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU tensors take the way of those on CUDA; float64 stays with the twin."""
    monkeypatch.setattr(dssim, "compiled_for", lambda *_: False)
    monkeypatch.setattr(device_kernels, "run_on", lambda *tensors: all(t.dtype is torch.float32 for t in tensors))


def pair(height: int, width: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(height)
    image = torch.rand(height, width, 3, generator=generator)
    return image, (image + 0.3 * torch.randn(height, width, 3, generator=generator)).clamp(0, 1)


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (23, 17), (16, 32)])
@pytest.mark.parametrize("share", [0.2, 0.0, 1.0])
def test_terms_and_gradient_equal_the_twin_in_float64(size: tuple[int, int], share: float) -> None:
    """The two terms arrive with different upstream gradients."""
    image, target = pair(*size)
    found: list[tuple[ImageTerms, Tensor]] = []
    for dtype in (torch.float32, torch.float64):
        leaf = image.to(dtype, copy=True).requires_grad_()
        terms = image_terms(leaf, target.to(dtype), share)
        (0.7 * terms.l1 - 1.3 * terms.dssim).backward()
        assert leaf.grad is not None
        found.append((terms, leaf.grad))
    (fast, gradient), (slow, expected) = found
    assert fast.l1.item() == pytest.approx(slow.l1.item(), rel=1e-5)
    assert fast.dssim.item() == pytest.approx(slow.dssim.item(), rel=1e-5, abs=1e-6)
    assert (gradient - expected).norm() <= 2e-5 * expected.norm() + 1e-9


def test_targets_are_those_of_the_twin() -> None:
    image, _ = pair(23, 17)
    found, expected = DssimTarget.of(image), DssimTarget.of(image.double())
    torch.testing.assert_close(found.mean.double(), expected.mean, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(found.square_mean.double(), expected.square_mean, atol=1e-6, rtol=1e-5)
    terms = image_terms_in_torch(image, found, (0.5, 0.5))
    torch.testing.assert_close(terms, image_terms(image, found, 0.5), atol=1e-6, rtol=1e-5)


def test_kernels_compile_without_spilling(registers_of: Callable[..., dict[str, int]]) -> None:
    image, truth = pair(2, 2)
    with recorded_launches() as launches:
        image_terms(image.requires_grad_(), truth, 0.2).dssim.backward()
    assert [launch.name for launch in launches] == [
        *("blur_products", "blur_means", "blur_products", "compare", "finish_terms"),
        *("blur_derivatives", "differentiate_terms"),
    ]
    assert max(registers_of(launches).values()) <= 96
