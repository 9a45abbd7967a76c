"""The worst-frames sheet: the frames on which a method is worst, with ground truth and error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evaluate.figures.contact_sheet import Row, contact_sheet, resize_to_width
from evaluate.figures.error_map import error_colors, shared_limit
from evaluate.figures.evaluation_images import EvaluationImages, worst_frames
from evaluate.metrics.catalogue import metric_of
from evaluate.metrics.pixels import absolute_error
from ggavatar.io.images import write_png


def worst_frames_sheet(
    evaluated: EvaluationImages, count: int = 6, metric: str = "psnr", width: int = 256
) -> np.ndarray:
    """Ground truth, prediction and error of the worst frames, the worst at the left.

    Args:
        evaluated: A method with its images.
        count: Number of frames.
        metric: Metric that ranks the frames.
        width: Width of one image, px.
    """
    frames, described = worst_frames([evaluated], count, metric), metric_of(metric)
    pairs = [evaluated.pair(frame) for frame in frames]
    errors = [absolute_error(prediction, truth) for prediction, truth in pairs]
    limit = shared_limit(errors)
    values = dict(zip(evaluated.evaluation.frames, evaluated.evaluation.values[metric], strict=True))
    unit = "" if described.unit == "1" else f" {described.unit}"
    captions = [f"{values[frame] or 0:.{described.digits}f}{unit}" for frame in frames]
    rows = [
        Row(
            [resize_to_width(truth, width) for _, truth in pairs],
            "ground truth",
            [f"frame {frame}" for frame in frames],
        ),
        Row([resize_to_width(prediction, width) for prediction, _ in pairs], "prediction", captions),
        Row([resize_to_width(error_colors(error, limit), width) for error in errors], "error"),
    ]
    mean = evaluated.evaluation.summary(metric).mean
    average = f"the mean is {mean or 0:.{described.digits}f}{unit}"
    note = f"Worst {described.title}; {average}. Error: mean |difference|, 0 to {limit:g}."
    return contact_sheet(rows, note=note)


def write_worst_frames(path: Path, evaluated: EvaluationImages, count: int = 6, metric: str = "psnr") -> None:
    """Write the sheet as a PNG; nothing is written if the metric has no value."""
    if worst_frames([evaluated], 1, metric):
        write_png(path, worst_frames_sheet(evaluated, count, metric))
