"""Images of a report: choice of frames within a byte budget, each image as a data URI."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from evaluate.figures.contact_sheet import resize_to_width
from evaluate.figures.error_map import error_colors, shared_limit
from evaluate.figures.evaluation_images import EvaluationImages, worst_frames
from evaluate.metrics.pixels import absolute_error

QUALITY, ERROR_QUALITY = 88, 70
"""WebP quality of images and of error maps."""
MAX_SIDE = 768
"""Larger images are scaled down to this, px."""


def report_images(compared: Sequence[EvaluationImages], megabytes: float) -> tuple[list[dict[str, Any]], float]:
    """Ground truth, predictions and errors of as many frames as fit, and the upper end of the error scale.

    The worst frames of the first method come first, then ever finer steps over the split, so a small budget still
    covers the whole range.

    Args:
        compared: Methods with the same frames.
        megabytes: Limit of the total size of all data URIs, 10⁶ bytes; at least one frame is included.
    """
    frames = sorted(set.intersection(*(set(one.evaluation.frames) for one in compared)))
    limit = shared_limit(absolute_error(*one.pair(frame)) for one in compared for frame in _spread(frames, 12))
    entries: list[dict[str, Any]] = []
    used = 0
    for frame in dict.fromkeys([*worst_frames(compared, 6), *_refining(frames)]):
        entry = _entry(compared, frame, limit)
        size = len(entry["truth"]) + sum(map(len, entry["predictions"])) + sum(map(len, entry["errors"]))
        if entries and used + size > megabytes * 1e6:
            break
        used += size
        entries.append(entry)
    return sorted(entries, key=lambda entry: entry["frame"]), limit


def _entry(compared: Sequence[EvaluationImages], frame: int, limit: float) -> dict[str, Any]:
    pairs = [one.pair(frame) for one in compared]
    errors = [error_colors(absolute_error(prediction, truth), limit) for prediction, truth in pairs]
    return {
        "frame": frame,
        "truth": data_uri(_bounded(pairs[0][1]), QUALITY),
        "predictions": [data_uri(_bounded(prediction), QUALITY) for prediction, _ in pairs],
        "errors": [data_uri(_bounded(error), ERROR_QUALITY) for error in errors],
    }


def data_uri(image: UInt8[np.ndarray, "H W 3"], quality: int) -> str:
    """An image as WebP in a data URI."""
    written, encoded = cv2.imencode(".webp", image[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
    if not written:
        raise ValueError(f"expected an image that WebP can encode, found {image.shape}")
    return "data:image/webp;base64," + base64.b64encode(encoded.tobytes()).decode()


def _bounded(image: np.ndarray) -> np.ndarray:
    """The image, scaled down if a side is longer than `MAX_SIDE`."""
    factor = MAX_SIDE / max(image.shape[:2])
    return image if factor >= 1 else resize_to_width(image, round(image.shape[1] * factor))


def _spread(frames: Sequence[int], count: int) -> list[int]:
    """At most `count` frames at even steps."""
    return list(frames[:: max(1, -(-len(frames) // count))])


def _refining(frames: Sequence[int]) -> Iterator[int]:
    """All frames in the order of ever finer steps: first, last, middle, quarters and so on."""
    yield frames[0]
    yield frames[-1]
    parts = 2
    while parts < 2 * len(frames):
        for part in range(1, parts, 2):
            yield frames[part * (len(frames) - 1) // parts]
        parts *= 2
    yield from frames
