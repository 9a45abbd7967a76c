"""Scoring speed for folders of images, and growth of memory with their number."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from skimage.data import astronaut

from benchmarks.measure import Timing, interleaved, peak_extra_megabytes, threads
from evaluate.protocols.protocol import protocol_by_name
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import FramePair, pair_folders
from evaluate.scoring.score import learned_metrics, score
from ggavatar.io.images import write_png
from ggavatar.io.ordered_map import available_cores
from ggavatar.pretrained.resolve import ModelFinder

PAIRS, SIZE = 200, 512
QUICK_PAIRS, QUICK_SIZE = 20, 128
METRICS = {"psnr_ssim": ("psnr", "ssim"), "psnr_ssim_lpips_alex": ("psnr", "ssim", "lpips_alex")}


def write_pairs(folder: Path, count: int, size: int) -> list[FramePair]:
    """Write a portrait that moves across the image, and blurred predictions of it, as PNG."""
    portrait = cv2.resize(astronaut(), (size, size), interpolation=cv2.INTER_AREA)
    for frame in range(count):
        truth = np.roll(portrait, frame, axis=1)
        write_png(folder / "truth" / f"{frame:06d}.png", truth)
        write_png(folder / "predictions" / f"{frame:06d}.png", cv2.GaussianBlur(truth, (0, 0), 1.0))
    return pair_folders(folder / "predictions", folder / "truth")


def scoring(pairs: Sequence[FramePair], names: Sequence[str], workers: int) -> Callable[[], object] | None:
    """A call that scores all pairs; None if weights are missing."""
    protocol = protocol_by_name("folders").override(metrics=names, table_metrics=names)
    learned = learned_metrics(protocol, ModelFinder())
    if learned and learned.missing:
        return None
    return lambda: score(pairs, protocol, Labels("portrait", "blur"), learned, threads=workers)


def figures(timing: Timing, count: int) -> dict[str, float]:
    """Pairs per second and CPU time per pair."""
    return {
        "pairs_per_second_wall": round(count / timing.wall_ms * 1e3, 2),
        "cpu_ms_per_pair": round(timing.cpu_ms / count, 2),
        "least_cpu_ms_per_pair": round(timing.least_cpu_ms / count, 2),
        "rounds": timing.rounds,
    }


def memory(pairs: Sequence[FramePair], names: Sequence[str], workers: int) -> dict[str, float | None]:
    """Memory for a quarter of the pairs, in addition to the networks, and what all pairs then add to it, MB."""
    quarter, whole = scoring(pairs[: len(pairs) // 4], names, workers), scoring(pairs, names, workers)
    if quarter is None or whole is None:
        return {}
    return {"quarter_of_pairs_mb": peak_extra_megabytes(quarter), "all_pairs_add_mb": peak_extra_megabytes(whole)}


def run(options: argparse.Namespace) -> dict[str, object]:
    """Measure both sets of metrics; LPIPS is skipped without its weights ($GGAVATAR_MODELS)."""
    count, size = (QUICK_PAIRS, QUICK_SIZE) if options.quick else (PAIRS, SIZE)
    workers = options.threads or available_cores()
    with tempfile.TemporaryDirectory() as folder, threads(workers):
        pairs = write_pairs(Path(folder), count, size)
        calls = {name: call for name, names in METRICS.items() if (call := scoring(pairs, names, workers))}
        used = {name: memory(pairs, METRICS[name], workers) for name in calls}
        timings = interleaved(calls, options.repeats or 3, warm_up=0)
    speed = {name: figures(timing, count) for name, timing in timings.items()}
    return {"pairs": count, "size": size, "workers": workers, "speed": speed, "memory": used}
