"""Small images for tests of scoring: smooth, colored, deterministic; and SSIM as a single number."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from evaluate.metrics.ssim import ssim_map, valid


def pair(height: int = 48, width: int = 64, shift: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A ground truth and a prediction that differs from it by a dither of ±15 levels."""
    y, x = np.mgrid[:height, :width]
    waves = (
        127 + 90 * np.sin((x + shift) / 9) + 30 * np.cos(y / 5),
        127 + 80 * np.cos((x + y + shift) / 13),
        255 * (x / width),
    )
    truth = np.stack(waves, axis=2).round().clip(0, 255).astype(np.uint8)
    dither = ((x * 7 + y * 13 + shift) % 31) - 15
    return truth, (truth.astype(int) + dither[..., None]).clip(0, 255).astype(np.uint8)


def write(path: Path, image: np.ndarray) -> None:
    """Write grayscale, RGB or RGBA with 8 or 16 bits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    order = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}
    pixels = cv2.cvtColor(image, order[image.shape[2]]) if image.ndim == 3 else image
    done, encoded = cv2.imencode(".png", pixels)
    assert done
    path.write_bytes(encoded.tobytes())


def write_folders(folder: Path, frames: list[int], height: int = 48, width: int = 64) -> tuple[Path, Path]:
    """Folders of predictions and ground truth for some frames."""
    for frame in frames:
        truth, render = pair(height, width, frame)
        write(folder / "gt" / f"{frame:06d}.png", truth)
        write(folder / "pred" / f"frame_{frame:04d}.png", render)
    return folder / "pred", folder / "gt"


def mean_ssim(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Wang et al. 2004: mean over the valid region and the channels."""
    return float(valid(ssim_map(prediction, truth)).mean(dtype=np.float64))


def mean_ssim_3dgs(prediction: np.ndarray, truth: np.ndarray) -> float:
    """As in code derived from 3DGS: mean over all pixels of the zero-padded images."""
    return float(ssim_map(prediction, truth).mean(dtype=np.float64))
