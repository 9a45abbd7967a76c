"""Qualitative comparison of methods: choice of representative frames, and the figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from evaluate.figures.comparison_layout import ComparisonFrame, comparison
from evaluate.scoring.frame_files import common_frames, find_frame, frame_file
from ggavatar.errors import InputError
from ggavatar.io.images import read_gray, read_rgb, write_png

QUANTILES = {0.1: "easy (best 10 %)", 0.5: "median", 0.95: "hard (worst 5 %)"}


def load_comparison_frame(
    frame: int, methods: Mapping[str, Path], truth: Path, label: str = "", focus: Sequence[Path] = ()
) -> ComparisonFrame:
    """Read one frame of every method, and the union of its masks in those folders of `focus` that have it.

    Raises:
        InputError: An image is missing, or sizes differ.
    """
    image = read_rgb(find_frame(truth, frame))
    predictions = {name: read_rgb(find_frame(folder, frame)) for name, folder in methods.items()}
    for name, prediction in predictions.items():
        if prediction.shape != image.shape:
            found = _size(prediction)
            raise InputError(f"{methods[name]}: expected frame {frame} of {_size(image)} px, found {found}")
    masks = [read_gray(path) for folder in focus if (path := frame_file(folder, frame)).is_file()]
    union = np.maximum.reduce(masks) if masks else None
    return ComparisonFrame(label or f"frame {frame}", image, predictions, union)


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]}×{image.shape[0]}"


def typical_frames(methods: Mapping[str, Path], truth: Path) -> dict[int, str]:
    """Representative frames: those at the 10th, 50th and 95th percentile of the mean error over methods.

    Returns:
        A description by frame number, starting with the easiest; fewer if there are fewer frames.
    """
    frames = common_frames([truth, *methods.values()])
    means = [_mean_error(load_comparison_frame(frame, methods, truth)) for frame in frames]
    order = np.argsort(means, kind="stable")
    chosen = {frames[order[round(quantile * (len(frames) - 1))]]: text for quantile, text in QUANTILES.items()}
    return {frame: f"frame {frame}: {text}" for frame, text in chosen.items()}


def _mean_error(frame: ComparisonFrame) -> float:
    return float(np.mean([error.mean() for error in frame.errors().values()]))


def write_comparison(
    path: Path,
    methods: Mapping[str, Path],
    truth: Path,
    frames: Sequence[int] | None = None,
    crops: int = 2,
    focus: Sequence[Path] = (),
) -> list[int]:
    """Write the comparison of several methods as a PNG.

    Args:
        path: File to write.
        methods: Folders of predictions by method, in the order of the columns.
        truth: Folder of ground truth.
        frames: Frames from the top; by default `typical_frames`, so that none is hand-picked.
        crops: Number of enlarged crops per image.
        focus: Folders of masks, such as face and mouth, within which the first crop is chosen.

    Returns:
        The frames shown.
    """
    labels = {frame: f"frame {frame}" for frame in frames} if frames else typical_frames(methods, truth)
    shown = [load_comparison_frame(frame, methods, truth, label, focus) for frame, label in labels.items()]
    write_png(path, comparison(shown, crops))
    return list(labels)
