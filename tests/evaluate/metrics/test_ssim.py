"""SSIM against skimage with Wang's settings and plain torch; MS-SSIM against values of pytorch-msssim 1.0.0."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity
from torch.nn.functional import conv2d

from evaluate.metrics import ssim
from evaluate.metrics.pixels import masked_mean
from tests.support.image_pairs import mean_ssim, mean_ssim_3dgs, pair

WANG = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}


@pytest.mark.parametrize("size", [(48, 64), (128, 131), (11, 11)])
def test_ssim_equals_skimage_with_the_settings_of_wang(size: tuple[int, int]) -> None:
    truth, render = pair(*size)
    expected = structural_similarity(truth / 255.0, render / 255.0, channel_axis=2, **WANG)
    assert mean_ssim(render, truth) == pytest.approx(expected, abs=1e-5)
    assert mean_ssim(render / 255.0, truth / 255.0) == pytest.approx(expected, abs=1e-5)


def test_ssim_of_luma_equals_skimage() -> None:
    truth, render = pair(64, 80)
    gray = [ssim.luma(image)[..., 0].astype(np.float64) for image in (truth, render)]
    np.testing.assert_allclose(gray[0], truth / 255.0 @ [0.299, 0.587, 0.114], atol=1e-6)
    expected = structural_similarity(*gray, **WANG)
    assert mean_ssim(ssim.luma(render), ssim.luma(truth)) == pytest.approx(expected, abs=1e-5)


def test_noise_and_flat_images_equal_skimage_too() -> None:
    random = np.random.default_rng(3)
    noise = random.integers(0, 256, (40, 40, 3), dtype=np.uint8)
    flat = np.full((40, 40, 3), 255, np.uint8)
    almost = flat.copy()
    almost[20, 20] = 254
    for first, second in ((noise, flat), (flat, almost), (noise, 255 - noise)):
        expected = structural_similarity(first / 255.0, second / 255.0, channel_axis=2, **WANG)
        assert mean_ssim(first, second) == pytest.approx(expected, abs=1e-5)


def zero_padded(first: np.ndarray, second: np.ndarray) -> float:
    """The 3DGS recipe in float64: direct 11×11 convolution with zero padding, then the mean."""
    grid = torch.arange(11, dtype=torch.float64) - 5
    line = torch.exp(-(grid**2) / (2 * 1.5**2))
    window = (line[:, None] * line[None] / line.sum() ** 2).expand(3, 1, 11, 11)
    x, y = (torch.from_numpy(image.transpose(2, 0, 1)[None] / 255.0) for image in (first, second))

    def blur(values: torch.Tensor) -> torch.Tensor:
        return conv2d(values, window, padding=5, groups=3)

    mean_x, mean_y = blur(x), blur(y)
    variance = blur(x * x) - mean_x**2 + blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    top = (2 * mean_x * mean_y + 1e-4) * (2 * covariance + 9e-4)
    return float((top / ((mean_x**2 + mean_y**2 + 1e-4) * (variance + 9e-4))).mean())


def test_the_3dgs_variant_pads_with_zeros() -> None:
    truth, render = pair()
    assert mean_ssim_3dgs(render, truth) == pytest.approx(zero_padded(render, truth), abs=1e-5)
    assert abs(mean_ssim_3dgs(render, truth) - mean_ssim(render, truth)) > 1e-4


@pytest.mark.parametrize(("size", "expected"), [((176, 200), 0.9699518809387815), ((241, 307), 0.9678497840481737)])
def test_ms_ssim_equals_pytorch_msssim(size: tuple[int, int], expected: float) -> None:
    truth, render = pair(*size)
    assert ssim.ms_ssim(render, truth) == pytest.approx(expected, abs=1e-5)


def test_ms_ssim_of_a_small_image_is_refused() -> None:
    truth, render = pair(160, 200)
    with pytest.raises(ValueError, match="more than 160 px"):
        ssim.ms_ssim(render, truth)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(11, 30), st.integers(11, 30))
def test_identical_images_score_exactly_one_and_others_less(seed: int, height: int, width: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    assert mean_ssim(image, image) == mean_ssim_3dgs(image, image) == 1
    other = image.copy()
    other[height // 2, width // 2, 0] ^= 255
    assert mean_ssim_3dgs(image, other) < 1
    assert mean_ssim_3dgs(image, other) == pytest.approx(mean_ssim_3dgs(other, image), abs=1e-6)


def test_the_map_averaged_over_a_region_sees_only_that_region() -> None:
    truth, render = pair()
    half_wrong = truth.copy()
    half_wrong[:, 40:] = render[:, 40:]
    values = ssim.ssim_map(half_wrong, truth).mean(axis=2)
    left = np.zeros(truth.shape[:2], np.float32)
    left[:, :30] = 1
    assert masked_mean(values, left) == pytest.approx(1, abs=1e-6)
    everywhere = masked_mean(values, np.ones_like(left))
    assert everywhere == pytest.approx(mean_ssim_3dgs(half_wrong, truth), abs=1e-6)
    assert everywhere < 0.99
    assert masked_mean(values, np.zeros_like(left)) is None
    with pytest.raises(ValueError, match="expected a mask of"):
        masked_mean(values, left[1:])


def test_an_image_smaller_than_the_window_is_refused() -> None:
    truth, render = pair(10, 40)
    with pytest.raises(ValueError, match="at least 11x11"):
        mean_ssim(render, truth)
