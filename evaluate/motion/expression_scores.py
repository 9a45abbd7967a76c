"""ARKit's 52 expression scores of a capture's frames, as the face landmarker measures them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from evaluate.motion.driving_sequence import DrivingSequence
from ggavatar.data.capture import Capture
from ggavatar.io.images import read_rgb
from ggavatar.landmarks.blendshapes import NAMES, BlendshapeNetwork
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable

LANDMARKS = 478


def with_scores(sequence: DrivingSequence, capture: Capture, finder: ModelFinder) -> DrivingSequence:
    """The sequence of a capture with the scores of its frames.

    It has none if the face landmarker cannot be had, or fewer than two frames show a face.

    Args:
        sequence: Frames of `capture`.
        capture: Where they come from; landmarks that it stores are used, other images are looked at.
        finder: Finds the networks.
    """
    try:
        bundle = finder.find("face_landmarker")
    except ModelUnavailable:
        return sequence
    stored = capture.tracking.landmarks
    if stored is not None and stored.shape[1] == LANDMARKS:
        network, rows = BlendshapeNetwork(bundle), [capture.frames.index(frame) for frame in sequence.frames]
        known = [network.scores(points) if np.isfinite(points).all() else _UNKNOWN for points in stored[rows]]
        return _with(sequence, np.array(known, np.float64))
    images = (read_rgb(capture.image_path("images", frame)) for frame in sequence.frames)
    return _with(sequence, scores_of(faces_in(images, LandmarkTracker(bundle))))


def _with(sequence: DrivingSequence, scores: Float[np.ndarray, "T 52"]) -> DrivingSequence:
    """The sequence with scores, unless fewer than two frames show a face."""
    enough = np.isfinite(scores).all(axis=1).sum() > 1
    return dataclasses.replace(sequence, scores=scores if enough else None)


_UNKNOWN = np.full(len(NAMES), np.nan)


def faces_in(images: Iterable[np.ndarray], tracker: LandmarkTracker) -> Iterator[Landmarks | None]:
    """The face in every image, each looked at on its own."""
    for image in images:
        tracker.reset()
        yield tracker.landmarks(image)


def scores_of(faces: Iterable[Landmarks | None]) -> Float[np.ndarray, "T 52"]:
    """Scores of faces; NaN where there is none."""
    return np.array([_UNKNOWN if face is None else face.blendshapes for face in faces], np.float64)
