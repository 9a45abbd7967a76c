"""Score pairs of pictures under a protocol: streaming, on a few threads, in bounded memory. No torch."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Protocol as Interface
from typing import TypeVar, runtime_checkable

import numpy as np

from evaluate.metrics.catalogue import FACES
from evaluate.metrics.faces import FaceMetrics
from evaluate.metrics.per_frame import measure_pixels
from evaluate.metrics.regions import boundary_band, fill_outside
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import Evaluation
from evaluate.scoring.accumulator import Accumulator, FrameScores, Labels
from evaluate.scoring.frame_pairs import FramePair
from evaluate.scoring.image_decoding import read_scored, read_weights
from ggavatar.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[int, int], None]

OFF = "learned metrics were switched off"
INSIDE = ("psnr", "mse", "l1")
"""What a protocol with a region measures over the region's pixels only."""


@runtime_checkable
class Perceptual(Interface):
    """Learned metrics, such as `evaluate.metrics.lpips.PerceptualMetrics`; `measure` is called from several threads."""

    missing: dict[str, str]
    hashes: dict[str, str]

    def measure(self, prediction: np.ndarray, truth: np.ndarray) -> Mapping[str, float]:
        """Values by metric name of one pair of 8-bit RGB images."""
        ...


def score(
    pairs: Sequence[FramePair],
    protocol: Protocol,
    labels: Labels,
    perceptual: Perceptual | None = None,
    faces: FaceMetrics | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Measure every pair and gather the evaluation.

    Args:
        pairs: Files by frame, ascending.
        protocol: What to measure.
        labels: Names for the table.
        perceptual: Learned metrics; `learned_metrics` gives them. None measures none.
        faces: Metrics of faces; None measures none.
        threads: Workers; as many as there are processors by default, at most 8.
        progress: Called with (done, total) after every frame.

    Raises:
        InputError: No pair, a damaged picture, or a region the protocol needs and no mask shows.
    """
    if not pairs:
        raise InputError("expected at least one frame to score, found none")
    if protocol.region != "full" and any(protocol.region not in pair.masks for pair in pairs):
        raise InputError(
            f"protocol {protocol.id} measures inside {protocol.region!r}; give masks of it with --region-masks DIR "
            f"(DIR/{protocol.region}/000123.png)"
        )
    gathering = Accumulator(protocol)

    def work(pair: FramePair) -> FrameScores:
        return score_pair(pair, protocol, perceptual, faces)

    for done, scored in enumerate(ordered_map(work, pairs, threads or min(8, os.cpu_count() or 1)), start=1):
        gathering.add(scored)
        if progress:
            progress(done, len(pairs))
    hashes = {name: value for part in (perceptual, faces) if part for name, value in part.hashes.items()}
    return gathering.evaluation(labels, unavailable(protocol, perceptual, faces), hashes)


def unavailable(protocol: Protocol, perceptual: Perceptual | None, faces: FaceMetrics | None) -> dict[str, str]:
    """The protocol's metrics that need a network and have none, with the reason."""
    missing = dict.fromkeys(learned_names(protocol), OFF) if perceptual is None else dict(perceptual.missing)
    of_faces = [name for name in protocol.metrics if name in FACES]
    return missing | (dict.fromkeys(of_faces, OFF) if faces is None else faces.missing)


def learned_names(protocol: Protocol) -> list[str]:
    """The protocol's metrics that need torch."""
    return [name for name in protocol.metrics if name.startswith("lpips")]


def face_metrics(protocol: Protocol, folders: Sequence[Path]) -> FaceMetrics | None:
    """The protocol's metrics of faces with networks from model folders; None if it has none."""
    names = [name for name in protocol.metrics if name in FACES]
    return FaceMetrics(names, folders) if names else None


def learned_metrics(protocol: Protocol, folders: Sequence[Path]) -> Perceptual | None:
    """The protocol's learned metrics with weights from model folders; torch is imported only if there are weights."""
    from ggavatar.pretrained.lpips import find_lpips

    names = learned_names(protocol)
    reasons = {name: find_lpips(name.removeprefix("lpips_").removesuffix("_unit_range"), folders) for name in names}
    if all(isinstance(reason, str) for reason in reasons.values()):
        return UnavailableLearnedMetrics({name: str(reason) for name, reason in reasons.items()})
    from evaluate.metrics.lpips import PerceptualMetrics

    return PerceptualMetrics(names, folders)


class UnavailableLearnedMetrics:
    """Stands in for learned metrics where there are no weights at all."""

    def __init__(self, missing: dict[str, str]) -> None:
        self.missing = missing
        self.hashes: dict[str, str] = {}

    def measure(self, prediction: np.ndarray, truth: np.ndarray) -> Mapping[str, float]:
        """No values."""
        return {}


def score_pair(
    pair: FramePair, protocol: Protocol, perceptual: Perceptual | None = None, faces: FaceMetrics | None = None
) -> FrameScores:
    """Read and measure one frame; `InputError` names a file that cannot be used."""
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
        values |= {name: values.pop(f"{name}@{protocol.region}") for name in INSIDE}
    if perceptual:
        values |= perceptual.measure(*images)
    error = None
    if faces:
        of_faces, error = faces.measure(*images)
        values |= of_faces
    notes = tuple(dict.fromkeys(prediction.notes + truth.notes))
    foreground = (weights["foreground"] >= 0.5).astype(np.uint8) if "foreground" in weights else None
    return FrameScores(pair.frame, values, images, foreground, hashes, notes, error)


def _inside(
    images: tuple[np.ndarray, np.ndarray], weights: Mapping[str, np.ndarray], protocol: Protocol
) -> tuple[np.ndarray, np.ndarray]:
    """Render and truth as they are, or painted outside the protocol's region."""
    if protocol.region == "full":
        return images
    color = protocol.background_rgb or (0.0, 0.0, 0.0)
    inside = weights[protocol.region]
    return fill_outside(images[0], inside, color), fill_outside(images[1], inside, color)


def _columns(protocol: Protocol) -> tuple[str, ...]:
    """Pixel metrics of one frame."""
    inside = () if protocol.region == "full" else tuple(f"{name}@{protocol.region}" for name in INSIDE)
    return ("mse", *protocol.columns, *inside)


def ordered_map(function: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Results of a function on a few threads, in the order of the items, with few of them in memory at a time."""
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads, thread_name_prefix="score") as pool:
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) > 2 * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
