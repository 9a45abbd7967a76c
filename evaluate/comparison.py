"""The qualitative comparison: ground truth and methods side by side, crops where they err, error maps on one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from evaluate.crops import Crop, choose_crops
from evaluate.frame_files import common_frames, frame_files
from evaluate.heatmap import colored, error_map, psnr, scale_bar, shared_limit
from evaluate.lettering import INK, MUTED, PAPER, Color, coverage, put
from evaluate.sheet import GAP, Row, resized, sheet, type_size
from ggavatar.errors import InputError
from ggavatar.pictures import read_rgb, write_png

CROP_COLORS: tuple[Color, ...] = ((0, 158, 115), (213, 94, 0), (0, 114, 178))
QUANTILES = {0.1: "easy (best 10 %)", 0.5: "median", 0.95: "hard (worst 5 %)"}


@dataclass(frozen=True)
class Sample:
    """One frame as several methods see it.

    Attributes:
        label: Written at the left of its rows.
        truth: Ground truth.
        renders: Pictures of the same size by method, in the order of the columns.
    """

    label: str
    truth: UInt8[np.ndarray, "H W 3"]
    renders: Mapping[str, UInt8[np.ndarray, "H W 3"]]

    def errors(self) -> dict[str, Float[np.ndarray, "H W"]]:
        """Error maps by method."""
        return {name: error_map(image, self.truth) for name, image in self.renders.items()}


def comparison(samples: Sequence[Sample], crops: int = 2, width: int | None = None) -> UInt8[np.ndarray, "H W 3"]:
    """Three rows a sample: pictures with PSNR, crops, error maps; one colour scale for the whole figure.

    Args:
        samples: From the top; all with the same methods.
        crops: Enlarged squares a picture, chosen where the mean error over methods is largest; 0 leaves the row out.
        width: Of one picture, px; by default that of the pictures, between 240 and 400.
    """
    names = list(samples[0].renders)
    if any(list(sample.renders) != names for sample in samples):
        raise ValueError(
            f"expected the methods {names} in every sample, got {[list(sample.renders) for sample in samples]}"
        )
    width = width or int(np.clip(samples[0].truth.shape[1], 240, 400))
    limit = shared_limit(error for sample in samples for error in sample.errors().values())
    rows = [
        row for index, sample in enumerate(samples) for row in _rows(sample, crops, width, limit, 3 * GAP * (index > 0))
    ]
    return sheet(
        rows,
        ["Ground truth", *names],
        note=f"Crops: largest mean error of all methods. Error: mean |difference| of R, G, B, 0 to {limit:g}.",
    )


def _rows(sample: Sample, count: int, width: int, limit: float, space: int) -> list[Row]:
    errors = sample.errors()
    crops = choose_crops(np.mean(list(errors.values()), axis=0), count)
    pictures = [sample.truth, *sample.renders.values()]
    captions = ["", *(f"{psnr(image, sample.truth):.2f} dB" for image in sample.renders.values())]
    rows = [Row([_marked(image, crops, width) for image in pictures], sample.label, captions, space)]
    if crops:
        rows.append(Row([_enlarged(image, crops, width) for image in pictures], "crops"))
    maps = [resized(colored(error, limit), width) for error in errors.values()]
    rows.append(Row([_legend(maps[0].shape[0], width, limit), *maps], "error"))
    return rows


def _marked(image: np.ndarray, crops: Sequence[Crop], width: int) -> np.ndarray:
    """A picture with the outlines of the crops."""
    shown, factor = resized(image, width).copy(), width / image.shape[1]
    for crop, color in zip(crops, CROP_COLORS, strict=False):
        first = (round(crop.left * factor), round(crop.top * factor))
        last = (round((crop.left + crop.size) * factor) - 1, round((crop.top + crop.size) * factor) - 1)
        cv2.rectangle(shown, first, last, color, 2)
    return shown


def _enlarged(image: np.ndarray, crops: Sequence[Crop], width: int) -> np.ndarray:
    """The crops side by side, each framed in its colour."""
    side = (width - GAP * (len(crops) - 1)) // len(crops)
    band = np.full((side, width, 3), PAPER, np.uint8)
    for index, (crop, color) in enumerate(zip(crops, CROP_COLORS, strict=False)):
        tile = crop.enlarged(image, side)
        cv2.rectangle(tile, (0, 0), (side - 1, side - 1), color, 3)
        band[:, index * (side + GAP) : index * (side + GAP) + side] = tile
    return band


def _legend(height: int, width: int, limit: float) -> np.ndarray:
    """The colour scale with its ends, in the place under the ground truth."""
    tile = np.full((height, width, 3), PAPER, np.uint8)
    size, bar = type_size(width), scale_bar(max(8, height // 14), round(width * 0.8))
    top, left = height // 2 - bar.shape[0], (width - bar.shape[1]) // 2
    tile[top : top + bar.shape[0], left : left + bar.shape[1]] = bar
    for text, position in (("0", 0.0), (f"{limit / 2:g}", 0.5), (f"≥ {limit:g}", 1.0)):
        covered = coverage(text, size * 0.85)
        put(tile, covered, left + round(position * (bar.shape[1] - covered.shape[1])), top + bar.shape[0] + 4, MUTED)
    title = coverage("mean |difference|", size * 0.85)
    put(tile, title, (width - title.shape[1]) // 2, top - title.shape[0] - 6, INK)
    return tile


def load_sample(frame: int, methods: Mapping[str, Path], truth: Path, label: str = "") -> Sample:
    """Read one frame of every method; `InputError` if a picture is missing or sizes differ."""
    files = {name: frame_files(folder) for name, folder in methods.items()}
    true_files = frame_files(truth)
    absent = [name for name, found in {**files, "ground truth": true_files}.items() if frame not in found]
    if absent:
        raise InputError(
            f"expected frame {frame} of every method, found none of {', '.join(absent)}; choose another frame"
        )
    image = read_rgb(true_files[frame])
    renders = {name: read_rgb(found[frame]) for name, found in files.items()}
    for name, render in renders.items():
        if render.shape != image.shape:
            raise InputError(f"{files[name][frame]}: expected {_size(image)} px, found {_size(render)}")
    return Sample(label or f"frame {frame}", image, renders)


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]}×{image.shape[0]}"


def typical_frames(methods: Mapping[str, Path], truth: Path) -> dict[int, str]:
    """Frames that stand for the whole: at the 10th, 50th and 95th percentile of the mean error over methods.

    Returns:
        A description by frame number, from the easiest; fewer where there are fewer frames.
    """
    frames = common_frames([truth, *methods.values()])
    means = [_mean_error(load_sample(frame, methods, truth)) for frame in frames]
    order = np.argsort(means, kind="stable")
    chosen = {frames[order[round(quantile * (len(frames) - 1))]]: text for quantile, text in QUANTILES.items()}
    return {frame: f"frame {frame}: {text}" for frame, text in chosen.items()}


def _mean_error(sample: Sample) -> float:
    return float(np.mean([error.mean() for error in sample.errors().values()]))


def write_comparison(
    path: Path, methods: Mapping[str, Path], truth: Path, frames: Sequence[int] | None = None, crops: int = 2
) -> list[int]:
    """Draw the comparison of folders of pictures into a PNG.

    Args:
        path: The file to write.
        methods: Folders of renders by method, in the order of the columns.
        truth: Folder of ground truth.
        frames: Which frames, from the top; by default an easy, the median and a hard one, so that
            none is hand-picked.
        crops: Enlarged squares a picture.

    Returns:
        The frames shown.
    """
    labels = {frame: f"frame {frame}" for frame in frames} if frames else typical_frames(methods, truth)
    samples = [load_sample(frame, methods, truth, label) for frame, label in labels.items()]
    write_png(path, comparison(samples, crops))
    return list(labels)
