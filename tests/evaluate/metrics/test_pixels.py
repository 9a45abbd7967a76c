"""Pixel metrics against skimage, closed forms and their own properties."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.metrics import peak_signal_noise_ratio

from evaluate.metrics import pixels
from tests.support.image_pairs import pair

IMAGES = hnp.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3)))


def test_psnr_equals_skimage_for_bytes_and_floats() -> None:
    truth, render = pair()
    expected = peak_signal_noise_ratio(truth, render, data_range=255)
    assert pixels.psnr(render, truth) == pytest.approx(expected, abs=1e-9)
    assert pixels.psnr(render / 255.0, truth / 255.0) == pytest.approx(expected, abs=1e-5)


def test_one_pixel_off_by_one_level_has_the_closed_form() -> None:
    truth = np.full((10, 20, 3), 100, np.uint8)
    render = truth.copy()
    render[3, 4, 1] += 1
    assert pixels.mean_squared_error(render, truth) == pytest.approx(1 / (600 * 255**2), rel=1e-12)
    assert pixels.psnr(render, truth) == pytest.approx(10 * math.log10(600 * 255**2), abs=1e-9)
    assert pixels.mean_absolute_error(render, truth) == pytest.approx(1 / (600 * 255), rel=1e-12)


def test_constant_images_differ_by_their_levels() -> None:
    black, white = np.zeros((5, 7, 3), np.uint8), np.full((5, 7, 3), 255, np.uint8)
    assert pixels.psnr(black, white) == pytest.approx(0, abs=1e-12)
    assert pixels.psnr(white, white) == math.inf


def test_images_of_other_size_or_dtype_are_refused() -> None:
    truth, render = pair()
    with pytest.raises(ValueError, match="one size and dtype"):
        pixels.psnr(render[1:], truth)
    with pytest.raises(ValueError, match="one size and dtype"):
        pixels.psnr(render / 255.0, truth)


@settings(deadline=None, max_examples=50)
@given(IMAGES, st.integers(0, 2**32 - 1))
def test_psnr_is_symmetric_infinite_only_for_equals_and_lower_for_a_flip(image: np.ndarray, seed: int) -> None:
    other = np.random.default_rng(seed).integers(0, 256, image.shape, dtype=np.uint8)
    assert pixels.psnr(image, image) == math.inf
    assert pixels.psnr(image, other) == pixels.psnr(other, image)
    assert (pixels.psnr(image, other) == math.inf) == np.array_equal(image, other)


def test_errors_per_pixel_equal_numpy_in_double_precision() -> None:
    truth, render = pair()
    difference = (render.astype(np.float64) - truth) / 255
    for images in ((render, truth), (render / 255.0, truth / 255.0)):
        np.testing.assert_allclose(pixels.absolute_error(*images), np.abs(difference).mean(axis=2), atol=1e-6)
        np.testing.assert_allclose(pixels.squared_error(*images), np.square(difference).mean(axis=2), atol=1e-7)
    for error in (pixels.absolute_error, pixels.squared_error):
        with pytest.raises(ValueError, match="one size and dtype"):
            error(render, truth[:-1])


def test_masked_metrics_of_a_full_mask_are_the_whole_and_of_half_a_mask_its_half() -> None:
    truth, render = pair()
    full = np.ones(truth.shape[:2], np.float32)
    squared = pixels.squared_error(render, truth)
    assert pixels.masked_psnr(squared, full) == pytest.approx(pixels.psnr(render, truth), abs=1e-5)
    expected = pixels.mean_absolute_error(render, truth)
    assert pixels.masked_mean(pixels.absolute_error(render, truth), full) == pytest.approx(expected, rel=1e-6)
    half = full.copy()
    half[:, 32:] = 0
    expected = pixels.psnr(render[:, :32], truth[:, :32])
    assert pixels.masked_psnr(squared, half) == pytest.approx(expected, abs=1e-5)


def test_masked_psnr_is_the_full_one_less_the_share_when_the_background_is_perfect() -> None:
    truth, render = pair()
    mask = np.zeros(truth.shape[:2], np.float32)
    mask[10:30, 20:40] = 1
    composed = np.where(mask[..., None] > 0, render, truth)
    masked = pixels.masked_psnr(pixels.squared_error(composed, truth), mask)
    share = float(mask.mean())
    assert masked == pytest.approx(pixels.psnr(composed, truth) + 10 * math.log10(share), abs=1e-5)


def test_an_empty_mask_gives_none_and_a_mask_of_other_size_is_refused() -> None:
    truth, render = pair()
    assert pixels.masked_psnr(pixels.squared_error(render, truth), np.zeros(truth.shape[:2], np.float32)) is None
    with pytest.raises(ValueError, match="expected a mask of"):
        pixels.masked_psnr(pixels.squared_error(render, truth), np.ones((3, 3), np.float32))


def test_pooling_never_exceeds_the_mean_of_images() -> None:
    errors = [0.01, 0.0001, 0.002]
    mean = sum(pixels.psnr_from_mse(error) for error in errors) / 3
    pooled = pixels.pooled_psnr(errors)
    assert pooled == pytest.approx(-10 * math.log10(sum(errors) / 3))
    assert pooled < mean
    assert pixels.pooled_psnr([]) is None
