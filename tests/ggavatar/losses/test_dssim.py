"""D-SSIM against scikit-image, float64 autograd and itself.

Also covers `ggavatar/losses/dssim_kernel.py`.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from ggavatar.losses.dssim import DssimTarget, dssim, dssim_in_torch, image_terms, image_terms_in_torch

SIZES = [(64, 48), (150, 37), (5, 3), (1, 1), (129, 20)]
"""Height and width; smaller than the window, and across the border of a stripe."""


def image_pair(height: int, width: int, dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(height * 1000 + width)
    target = torch.rand(height, width, 3, generator=generator, dtype=torch.float64)
    image = (target + 0.2 * torch.randn(height, width, 3, generator=generator, dtype=torch.float64)).clamp(0, 1)
    return image.to(dtype), target.to(dtype)


def relative(ours: torch.Tensor, reference: torch.Tensor) -> float:
    return float((ours.double() - reference.double()).norm() / reference.double().norm())


@pytest.mark.parametrize("size", SIZES)
def test_compiled_value_and_gradient_equal_float64_autograd(size: tuple[int, int]) -> None:
    image, target = image_pair(*size)
    image.requires_grad_()
    reference = image.detach().double().requires_grad_()
    value = dssim(image, DssimTarget.of(target))
    expected = dssim_in_torch(reference, DssimTarget.of(target.double()))
    (3 * value).backward()
    (3 * expected).backward()
    assert value.item() == pytest.approx(expected.item(), rel=1e-6, abs=1e-7)
    assert image.grad is not None and reference.grad is not None
    assert relative(image.grad, reference.grad) < 2e-6


def test_interior_equals_scikit_image() -> None:
    """Zero padding differs from scikit-image's border only: the maps agree where the window lies inside."""
    image, target = image_pair(40, 50, torch.float64)
    _, expected = structural_similarity(
        image.numpy(), target.numpy(), gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        data_range=1.0, channel_axis=-1, full=True,
    )  # fmt: skip
    # Zeros around the images make scikit-image equal to zero padding.
    padded_image, padded_target = torch.zeros(60, 70, 3).double(), torch.zeros(60, 70, 3).double()
    padded_image[10:50, 10:60], padded_target[10:50, 10:60] = image, target
    _, zero_padded = structural_similarity(
        padded_image.numpy(), padded_target.numpy(), gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        data_range=1.0, channel_axis=-1, full=True,
    )  # fmt: skip
    ours = dssim(image.float(), target.float()).item()
    assert ours == pytest.approx(1 - float(np.mean(zero_padded[10:50, 10:60])), abs=2e-6)
    assert np.allclose(zero_padded[15:45, 15:55], expected[5:35, 5:45])


def test_identical_images_cost_nothing_and_push_nowhere() -> None:
    image, _ = image_pair(64, 64)
    image.requires_grad_()
    value = dssim(image, image.detach())
    value.backward()
    assert value.item() == pytest.approx(0, abs=1e-6)
    assert image.grad is not None and image.grad.abs().max() < 1e-7


def test_gradcheck_of_the_twin() -> None:
    image, target = image_pair(3, 4, torch.float64)
    kept = DssimTarget.of(target)
    assert torch.autograd.gradcheck(lambda x: dssim_in_torch(x, kept), image.requires_grad_())


def test_kept_target_equals_plain_target_and_twin() -> None:
    image, target = image_pair(64, 48)
    kept, wide = DssimTarget.of(target), DssimTarget.of(target.double())
    assert dssim(image, kept).item() == dssim(image, target).item()
    assert relative(kept.mean, wide.mean) < 1e-6 and relative(kept.square_mean, wide.square_mean) < 1e-6


@pytest.mark.parametrize("threads", [2, 4])
def test_same_bits_for_any_number_of_threads(threads: int) -> None:
    found = []
    before = torch.get_num_threads()
    try:
        for count in (1, threads):
            torch.set_num_threads(count)
            image, target = image_pair(300, 64)
            image.requires_grad_()
            value = dssim(image, target)
            value.backward()
            found.append((value.item(), image.grad))
    finally:
        torch.set_num_threads(before)
    assert found[0][0] == found[1][0]
    assert torch.equal(found[0][1], found[1][1])


def test_no_gradient_without_need_and_other_channel_counts_use_the_twin() -> None:
    image, target = image_pair(20, 20)
    assert not dssim(image, target).requires_grad
    grey = dssim(image[..., :1].requires_grad_(), target[..., :1])
    assert grey.item() == pytest.approx(
        dssim_in_torch(image[..., :1].double(), DssimTarget.of(target[..., :1].double())).item(), rel=1e-5
    )


def test_non_contiguous_images() -> None:
    image, target = image_pair(32, 32)
    turned = image.permute(1, 0, 2).requires_grad_()
    dssim(turned, target).backward()
    plain = turned.detach().contiguous().requires_grad_()
    dssim(plain, target).backward()
    assert turned.grad is not None and plain.grad is not None
    assert torch.equal(turned.grad, plain.grad)


@pytest.mark.parametrize("upstream", [(1.0, 1.0), (3.0, 3.0), (0.5, 2.0), (0.0, 1.0)])
def test_image_terms_and_their_gradient_equal_float64(upstream: tuple[float, float]) -> None:
    generator = torch.Generator().manual_seed(4)
    image, target = (torch.rand(150, 37, 3, generator=generator) for _ in range(2))
    image[:9, :9] = target[:9, :9]  # no sign where there is no difference
    drawn, wide = image.clone().requires_grad_(), image.double().requires_grad_()
    terms = image_terms(drawn, target, 0.2)
    expected = image_terms_in_torch(wide, DssimTarget.of(target.double()), (0.8, 0.2))
    for found, term, factor in zip(terms, expected, upstream, strict=True):
        assert found.item() == pytest.approx(term.item(), rel=1e-5)
        (factor * term).backward(retain_graph=True)
    (upstream[0] * terms.l1 + upstream[1] * terms.dssim).backward()
    assert drawn.grad is not None and wide.grad is not None
    assert torch.allclose(drawn.grad.double(), wide.grad, atol=1e-5 * float(wide.grad.abs().max()))


def test_a_share_of_zero_is_plain_l1() -> None:
    image, target = torch.rand(12, 9, 3, requires_grad=True), torch.rand(12, 9, 3)
    terms = image_terms(image, target, 0.0)
    assert terms.l1.item() == pytest.approx((image - target).abs().mean().item(), rel=1e-6) and terms.dssim.item() == 0
