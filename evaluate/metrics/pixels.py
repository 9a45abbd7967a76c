"""Pixel-wise metrics of one pair of images, as pure functions on numpy arrays.

Images are H×W×3, either uint8 (range 255) or floating point in [0, 1] (range 1). Results are relative to the range, so
both give the same values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Image = UInt8[np.ndarray, "_H _W 3"] | Float[np.ndarray, "_H _W 3"]
Weights = Float[np.ndarray, "_H _W"]
"""Dimensions with underscores are not checked by jaxtyping: the functions compare them and explain a mismatch."""


def mean_squared_error(prediction: Image, target: Image) -> float:
    """Mean of the squared differences over all pixels and channels, range 1.

    Args:
        prediction: Rendered image.
        target: Ground truth of the same size and dtype.

    Raises:
        ValueError: The images differ in size or dtype.
    """
    _require_alike(prediction, target)
    squares = cv2.norm(np.ascontiguousarray(prediction), np.ascontiguousarray(target), cv2.NORM_L2SQR)
    return squares / prediction.size / _range(prediction) ** 2


def mean_absolute_error(prediction: Image, target: Image) -> float:
    """Mean of the absolute differences over all pixels and channels, range 1."""
    _require_alike(prediction, target)
    total = cv2.norm(np.ascontiguousarray(prediction), np.ascontiguousarray(target), cv2.NORM_L1)
    return total / prediction.size / _range(prediction)


def squared_error(prediction: Image, target: Image) -> Float[np.ndarray, "H W"]:
    """Squared difference at every pixel, mean over channels, range 1."""
    _require_alike(prediction, target)
    difference = cv2.absdiff(prediction, target).astype(np.float32) / np.float32(_range(prediction))
    return np.square(difference).mean(axis=2)


def absolute_error(prediction: Image, target: Image) -> Float[np.ndarray, "H W"]:
    """Absolute difference at every pixel, mean over channels, range 1."""
    _require_alike(prediction, target)
    difference = cv2.absdiff(prediction, target)
    return difference.mean(axis=2, dtype=np.float32) / np.float32(_range(prediction))


def masked_mean(values: Float[np.ndarray, "_H _W"], weights: Weights) -> float | None:
    """Mean of an error or SSIM map over a region: Σ w·value / Σ w; None if all weights are zero.

    PointAvatar and MonoGaussianAvatar divide the masked sum by all pixels instead, which adds −10·log10(foreground
    fraction) dB to PSNR. Painting the outside black in both images would raise SSIM toward 0.99.

    Raises:
        ValueError: The mask has another size.
    """
    if values.shape != weights.shape:
        raise ValueError(f"expected a mask of {values.shape} px (height, width), got {weights.shape}")
    total = float(weights.sum(dtype=np.float64))
    return float(np.vdot(values.astype(np.float64), weights)) / total if total > 0 else None


def psnr_from_mse(squared_error: float) -> float:
    """PSNR in dB of a mean squared error of range 1: −10·log10(MSE); infinite for zero."""
    return -10 * math.log10(squared_error) if squared_error > 0 else math.inf


def psnr(prediction: Image, target: Image) -> float:
    """Peak signal-to-noise ratio of one image over all pixels and channels, dB; infinite for identical images.

    The 3DGS code averages one PSNR per channel of a [3, H, W] image, which is up to 0.05 dB higher.
    """
    return psnr_from_mse(mean_squared_error(prediction, target))


def masked_psnr(squared_errors: Float[np.ndarray, "_H _W"], weights: Weights) -> float | None:
    """PSNR of the masked mean of `squared_error`, dB; None if all weights are zero."""
    error = masked_mean(squared_errors, weights)
    return None if error is None else psnr_from_mse(error)


def pooled_psnr(squared_errors: Iterable[float]) -> float | None:
    """PSNR of the mean squared error over all images, dB: at most the mean of their PSNRs; None without images."""
    errors = list(squared_errors)
    return psnr_from_mse(math.fsum(errors) / len(errors)) if errors else None


def _range(image: Image) -> float:
    return 255.0 if image.dtype == np.uint8 else 1.0


def _require_alike(prediction: Image, target: Image) -> None:
    if prediction.shape != target.shape or prediction.dtype != target.dtype:
        found = f"{prediction.shape} {prediction.dtype} and {target.shape} {target.dtype}"
        raise ValueError(f"expected two images of one size and dtype, got {found}")
