"""The worst-frames sheet: where a method fails, with ground truth and error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evaluate.figures.contact_sheet import Row, contact_sheet, resize_to_width
from evaluate.figures.error_map import error_colors, shared_limit
from evaluate.figures.evaluation_images import EvaluationImages, worst_frames
from evaluate.metrics.catalogue import metric_of
from evaluate.metrics.pixels import absolute_error
from ggavatar.io.images import write_png


def worst_frames_sheet(shown: EvaluationImages, count: int = 6, metric: str = "psnr", width: int = 256) -> np.ndarray:
    """Ground truth, render and error of the worst frames, the worst at the left.

    Args:
        shown: A method with its pictures.
        count: Number of frames.
        metric: By which they are worst.
        width: Of one picture, px.
    """
    frames, described = worst_frames([shown], count, metric), metric_of(metric)
    pairs = [shown.pair(frame) for frame in frames]
    errors = [absolute_error(render, truth) for render, truth in pairs]
    limit = shared_limit(errors)
    values = dict(zip(shown.evaluation.frames, shown.evaluation.values[metric], strict=True))
    unit = "" if described.unit == "1" else f" {described.unit}"
    captions = [f"{values[frame] or 0:.{described.digits}f}{unit}" for frame in frames]
    rows = [
        Row(
            [resize_to_width(truth, width) for _, truth in pairs],
            "ground truth",
            [f"frame {frame}" for frame in frames],
        ),
        Row([resize_to_width(render, width) for render, _ in pairs], "render", captions),
        Row([resize_to_width(error_colors(error, limit), width) for error in errors], "error"),
    ]
    mean = shown.evaluation.summary(metric).mean
    average = f"the mean is {mean or 0:.{described.digits}f}{unit}"
    note = f"Worst {described.title}; {average}. Error: mean |difference|, 0 to {limit:g}."
    return contact_sheet(rows, note=note)


def write_worst_frames(path: Path, shown: EvaluationImages, count: int = 6, metric: str = "psnr") -> None:
    """Draw the sheet into a PNG; nothing is written where the metric has no value."""
    if worst_frames([shown], 1, metric):
        write_png(path, worst_frames_sheet(shown, count, metric))
