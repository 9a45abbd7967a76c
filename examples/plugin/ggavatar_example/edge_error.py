"""Edge error: how far the edges of a rendering are from those of the photograph (an example of a metric)."""

from __future__ import annotations

import cv2
import numpy as np

from evaluate.metrics.metric import Metric

METRIC = Metric(
    name="edge_error",
    title="Edges",
    higher_is_better=False,
    digits=4,
    unit="1",
    definition=(
        "mean |difference| between the gradient magnitudes of render and truth, 3x3 Sobel / 8 on 0.299 R + 0.587 G + "
        "0.114 B in [0, 1], weighted by the mask if there is one"
    ),
    tolerance=0.02,
    relative_tolerance=True,
)


def measure(prediction: np.ndarray, truth: np.ndarray, foreground: np.ndarray | None) -> float | None:
    """The error of one frame: 8-bit RGB [H, W, 3], coverage [H, W] in [0, 1]; None where nothing is covered."""
    difference = np.abs(_edges(prediction) - _edges(truth))
    weights = np.ones_like(difference) if foreground is None else foreground
    total = float(weights.sum())
    return float((difference * weights).sum()) / total if total > 0 else None


def _edges(image: np.ndarray) -> np.ndarray:
    gray = image.astype(np.float64) @ np.array([0.299, 0.587, 0.114]) / 255
    across, down = (cv2.Sobel(gray, cv2.CV_64F, dx, 1 - dx) / 8 for dx in (1, 0))
    return np.hypot(across, down)
