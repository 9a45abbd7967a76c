"""The combined measurement equals the single functions that define each metric."""

from __future__ import annotations

import numpy as np
import pytest

from evaluate.metrics import pixels, ssim
from evaluate.metrics.per_frame import measure_pixels
from tests.support.image_pairs import mean_ssim, mean_ssim_3dgs, pair


def test_shared_maps_give_what_the_definitions_give() -> None:
    truth, render = pair(176, 180)
    weights = np.zeros(truth.shape[:2], np.float32)
    weights[20:90, 30:150] = 0.5
    weights[40:60, 40:60] = 1
    names = ["psnr", "mse", "l1", "ssim", "ssim_luma", "ssim_3dgs", "ssim_3dgs_luma", "ms_ssim"]
    masked = [f"{name}@face" for name in ("psnr", "mse", "l1", "ssim", "ssim_luma", "ssim_3dgs", "ssim_3dgs_luma")]
    found = measure_pixels(render, truth, [*names, *masked, "lpips_alex", "flicker"], {"face": weights})
    assert set(found) == {*names, *masked}
    lumas = ssim.luma(render), ssim.luma(truth)
    inner, squared = weights[5:-5, 5:-5], pixels.squared_error(render, truth)
    expected = {
        "psnr": pixels.psnr(render, truth),
        "mse": pixels.mean_squared_error(render, truth),
        "l1": pixels.mean_absolute_error(render, truth),
        "ssim": mean_ssim(render, truth),
        "ssim_luma": mean_ssim(*lumas),
        "ssim_3dgs": mean_ssim_3dgs(render, truth),
        "ssim_3dgs_luma": mean_ssim_3dgs(*lumas),
        "ms_ssim": ssim.ms_ssim(render, truth),
        "psnr@face": pixels.masked_psnr(squared, weights),
        "mse@face": pixels.masked_mean(squared, weights),
        "l1@face": pixels.masked_mean(pixels.absolute_error(render, truth), weights),
        "ssim@face": pixels.masked_mean(ssim.valid(ssim.ssim_map(render, truth)).mean(axis=2), inner),
        "ssim_luma@face": pixels.masked_mean(ssim.valid(ssim.ssim_map(*lumas)).mean(axis=2), inner),
        "ssim_3dgs@face": pixels.masked_mean(ssim.ssim_map(render, truth).mean(axis=2), weights),
        "ssim_3dgs_luma@face": pixels.masked_mean(ssim.ssim_map(*lumas).mean(axis=2), weights),
    }
    assert found == pytest.approx(expected, rel=1e-6)


def test_empty_full_and_absent_masks() -> None:
    truth, render = pair()
    shape = truth.shape[:2]
    columns = ["psnr@empty", "ssim@empty", "psnr@full", "ssim_3dgs@full", "l1@absent"]
    masks = {"empty": np.zeros(shape, np.float32), "full": np.ones(shape, np.float32)}
    found = measure_pixels(render, truth, columns, masks)
    assert found["psnr@empty"] is None
    assert found["ssim@empty"] is None
    assert found["l1@absent"] is None
    assert found["psnr@full"] == pytest.approx(pixels.psnr(render, truth), rel=1e-6)
    assert found["ssim_3dgs@full"] == pytest.approx(mean_ssim_3dgs(render, truth), rel=1e-6)


def test_images_too_small_for_a_metric_give_none() -> None:
    truth, render = pair(8, 8)
    found = measure_pixels(
        render, truth, ["psnr", "ssim", "ssim_3dgs", "ms_ssim", "ssim@face"], {"face": np.ones((8, 8), np.float32)}
    )
    assert found["ssim"] is found["ms_ssim"] is found["ssim@face"] is None
    assert found["psnr"] is not None
    assert found["ssim_3dgs"] is not None
