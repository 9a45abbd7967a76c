"""Scores pairs of images under a protocol: streaming, on a few threads, in bounded memory. Needs no torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol as Interface
from typing import runtime_checkable

import numpy as np

from evaluate.metrics.catalogue import FACES, METRICS, plugged_metrics
from evaluate.metrics.faces import FaceMetrics
from evaluate.metrics.network_files import find_lpips, network_of
from evaluate.metrics.per_frame import measure_pixels
from evaluate.metrics.plugged import PluggedMetrics
from evaluate.metrics.regions import boundary_band, fill_outside
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import Evaluation
from evaluate.scoring.accumulator import Accumulator, FrameScores, Labels
from evaluate.scoring.frame_pairs import FramePair
from evaluate.scoring.image_decoding import read_scored, read_weights
from ggavatar.errors import InputError
from ggavatar.io.ordered_map import available_cores, ordered_map
from ggavatar.pretrained.resolve import ModelFinder

Progress = Callable[[int, int], None]

SWITCHED_OFF = "learned metrics were switched off"
FLAT_SPREAD = 2
"""Levels of 255 by which an image of one color varies: rounding and the losses of JPEG."""
INSIDE_METRICS = ("psnr", "mse", "l1")
"""Metrics that a protocol with a region measures over only the region's pixels."""


@runtime_checkable
class LearnedMetrics(Interface):
    """Learned metrics such as `evaluate.metrics.lpips.PerceptualMetrics`; `measure` is called from several threads."""

    missing: dict[str, str]
    hashes: dict[str, str]

    def measure(self, prediction: np.ndarray, truth: np.ndarray) -> Mapping[str, float]:
        """Values by metric name of one pair of 8-bit RGB images."""
        ...


def score(
    pairs: Sequence[FramePair],
    protocol: Protocol,
    labels: Labels,
    learned: LearnedMetrics | None = None,
    faces: FaceMetrics | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Measure every pair of images and collect an evaluation.

    Args:
        pairs: Pairs of files by ascending frame number.
        protocol: What to measure.
        labels: Names for the table.
        learned: Learned metrics, from `learned_metrics`; None to skip them.
        faces: Face metrics, from `face_metrics`; None to skip them.
        threads: Number of threads; by default one per core, at most 8.
        progress: Called with (done, total) after every frame.

    Raises:
        InputError: No pairs, a damaged image, or no mask of a region that the protocol needs.
    """
    if not pairs:
        raise InputError("expected at least one frame to score, found none")
    if protocol.region != "full" and any(protocol.region not in pair.masks for pair in pairs):
        raise InputError(
            f"protocol {protocol.id} measures inside {protocol.region!r}: expected a mask of it for every frame; pass "
            f"--region-masks DIR (DIR/{protocol.region}/000123.png)"
        )
    accumulator = Accumulator(protocol)
    plugged = plugged_metrics(protocol.metrics)

    def work(pair: FramePair) -> FrameScores:
        return score_pair(pair, protocol, learned, faces, plugged)

    for done, scored in enumerate(ordered_map(work, pairs, threads or min(8, available_cores())), start=1):
        accumulator.add(scored)
        if progress:
            progress(done, len(pairs))
    missing = unavailable(protocol, learned, faces) | plugged.failed
    return accumulator.evaluation(labels, missing, source_hashes(protocol, learned, faces))


def source_hashes(protocol: Protocol, learned: LearnedMetrics | None, faces: FaceMetrics | None) -> dict[str, str]:
    """SHA-256 of what measures beside our own code: files of networks, and sources of other packages' metrics."""
    found = {name: value for part in (learned, faces) if part for name, value in part.hashes.items()}
    return found | plugged_metrics(protocol.metrics).hashes


def unavailable(protocol: Protocol, learned: LearnedMetrics | None, faces: FaceMetrics | None) -> dict[str, str]:
    """Reasons by metric of the protocol whose network is not available."""
    missing = dict.fromkeys(learned_names(protocol), SWITCHED_OFF) if learned is None else dict(learned.missing)
    face_names = [name for name in protocol.metrics if name in FACES]
    return missing | (dict.fromkeys(face_names, SWITCHED_OFF) if faces is None else faces.missing)


def learned_names(protocol: Protocol) -> list[str]:
    """The protocol's metrics that need torch (LPIPS)."""
    return [name for name in protocol.metrics if name.startswith("lpips") and name in METRICS]


def face_metrics(protocol: Protocol, models: ModelFinder) -> FaceMetrics | None:
    """The protocol's face metrics, with networks that are found or fetched; None if it has none."""
    names = [name for name in protocol.metrics if name in FACES]
    return FaceMetrics(names, models) if names else None


def learned_metrics(protocol: Protocol, models: ModelFinder) -> LearnedMetrics | None:
    """The protocol's learned metrics, with weights that are found or fetched; imports torch only if there are some."""
    names = learned_names(protocol)
    found = find_lpips(names, models)
    if all(isinstance(files, str) for files in found.values()):
        return UnavailableLearnedMetrics({name: str(found[network_of(name)]) for name in names})
    from evaluate.metrics.lpips import PerceptualMetrics

    return PerceptualMetrics(names, models)


class UnavailableLearnedMetrics:
    """Stand-in for learned metrics when no weights are available."""

    def __init__(self, missing: dict[str, str]) -> None:
        self.missing = missing
        self.hashes: dict[str, str] = {}

    def measure(self, prediction: np.ndarray, truth: np.ndarray) -> Mapping[str, float]:
        """No values."""
        return {}


def score_pair(
    pair: FramePair,
    protocol: Protocol,
    learned: LearnedMetrics | None = None,
    faces: FaceMetrics | None = None,
    plugged: PluggedMetrics | None = None,
) -> FrameScores:
    """Read and measure one frame; `InputError` names an unusable file."""
    prediction = read_scored(pair.prediction, protocol.background_rgb)
    truth = read_scored(pair.truth, protocol.background_rgb)
    hashes = {"predictions": prediction.sha256, "ground_truth": truth.sha256}
    weights: dict[str, np.ndarray] = {}
    for region, path in pair.masks.items():
        weights[region], hashes[f"masks/{region}"] = read_weights(path)
    if "foreground" in weights:
        weights.setdefault("boundary", boundary_band(weights["foreground"]))
    images = _inside((prediction.pixels, truth.pixels), weights, protocol)
    values = measure_pixels(*images, _columns(protocol), weights)
    if protocol.region != "full":
        values |= {name: values.pop(f"{name}@{protocol.region}") for name in INSIDE_METRICS}
    if learned:
        values |= learned.measure(*images)
    error = None
    if faces:
        face_values, error = faces.measure(*images)
        values |= face_values
    if plugged:
        values |= plugged.measure(*images, weights.get("foreground"))
    notes = tuple(dict.fromkeys(prediction.notes + truth.notes))
    foreground = (weights["foreground"] >= 0.5).astype(np.uint8) if "foreground" in weights else None
    flat = is_flat(prediction.pixels)
    return FrameScores(pair.frame, values, images, foreground, hashes, notes, error, flat)


def is_flat(pixels: np.ndarray) -> bool:
    """Whether no channel of an image of 8 bits varies by more than `FLAT_SPREAD` levels."""
    return all(int(channel.max()) - int(channel.min()) <= FLAT_SPREAD for channel in np.moveaxis(pixels, 2, 0))


def _inside(
    images: tuple[np.ndarray, np.ndarray], weights: Mapping[str, np.ndarray], protocol: Protocol
) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and ground truth, filled outside the protocol's region if it has one."""
    if protocol.region == "full":
        return images
    color = protocol.background_rgb or (0.0, 0.0, 0.0)
    inside = weights[protocol.region]
    return fill_outside(images[0], inside, color), fill_outside(images[1], inside, color)


def _columns(protocol: Protocol) -> tuple[str, ...]:
    """Names of the pixel metrics of one frame."""
    inside = () if protocol.region == "full" else tuple(f"{name}@{protocol.region}" for name in INSIDE_METRICS)
    return ("mse", *protocol.columns, *inside)
