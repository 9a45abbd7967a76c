"""ARKit's 52 expression scores of a capture's frames, as the face landmarker measures them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float

from evaluate.motion.driving_sequence import DrivingSequence
from ggavatar.data.capture import Capture
from ggavatar.io.images import read_rgb
from ggavatar.landmarks.blendshapes import NAMES, BlendshapeNetwork
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable

LANDMARKS = 478


def with_scores(
    sequence: DrivingSequence,
    capture: Capture,
    finder: ModelFinder,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> DrivingSequence:
    """The sequence of a capture with the scores of its frames; without them if the face landmarker cannot be had.

    Args:
        sequence: Frames of `capture`.
        capture: Where they come from; landmarks that it stores are used, other images are looked at.
        finder: Finds the networks.
        report: Called with (done, total) after every image.
    """
    try:
        bundle = finder.find("face_landmarker")
    except ModelUnavailable:
        return sequence
    stored = capture.tracking.landmarks
    if stored is not None and stored.shape[1] == LANDMARKS:
        network, rows = BlendshapeNetwork(bundle), [capture.frames.index(frame) for frame in sequence.frames]
        known = [network.scores(points) if np.isfinite(points).all() else _UNKNOWN for points in stored[rows]]
        return dataclasses.replace(sequence, scores=np.array(known, np.float64))
    images = (read_rgb(capture.image_path("images", frame)) for frame in sequence.frames)
    scores = image_scores(images, LandmarkTracker(bundle), lambda done: report(done, len(sequence.frames)))
    return dataclasses.replace(sequence, scores=scores if np.isfinite(scores).all(axis=1).sum() > 1 else None)


_UNKNOWN = np.full(len(NAMES), np.nan)


def image_scores(
    images: Iterable[np.ndarray], tracker: LandmarkTracker, report: Callable[[int], None] = lambda done: None
) -> Float[np.ndarray, "T 52"]:
    """Scores of images, each on its own; NaN where no face is found."""
    scores = []
    for image in images:
        tracker.reset()
        found = tracker.landmarks(image)
        scores.append(_UNKNOWN if found is None else found.blendshapes)
        report(len(scores))
    return np.array(scores, np.float64)
