"""ARKit's 52 expression scores of a capture's frames, as the face landmarker measures them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from ggavatar.data.capture import Capture
from ggavatar.data.capture_without_images import CaptureWithoutImages
from ggavatar.io.images import read_rgb
from ggavatar.landmarks.blendshapes import NAMES, BlendshapeNetwork
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable

LANDMARKS = 478
_UNKNOWN = np.full(len(NAMES), np.nan)


def measured_scores(capture: Capture, frames: Sequence[int], finder: ModelFinder) -> Float[np.ndarray, "T 52"] | None:
    """The scores of some frames in the order of `NAMES`, NaN without a face.

    None if the face landmarker cannot be had, or fewer than two of the frames show a face.

    Args:
        capture: Landmarks that it stores are used, other images are looked at.
        frames: Source frame numbers.
        finder: Finds the networks.
    """
    rows = [capture.row(frame) for frame in frames]
    if isinstance(capture, CaptureWithoutImages):
        return None if capture.scores is None else _enough(capture.scores[rows])
    try:
        bundle = finder.find("face_landmarker")
    except ModelUnavailable:
        return None
    stored = capture.tracking.landmarks
    if stored is not None and stored.shape[1] == LANDMARKS:
        network = BlendshapeNetwork(bundle)
        known = [network.scores(points) if np.isfinite(points).all() else _UNKNOWN for points in stored[rows]]
        return _enough(np.array(known, np.float64))
    images = (read_rgb(capture.image_path("images", frame)) for frame in frames)
    return _enough(scores_of(faces_in(images, LandmarkTracker(bundle))))


def _enough(scores: Float[np.ndarray, "T 52"]) -> Float[np.ndarray, "T 52"] | None:
    return scores if np.isfinite(scores).all(axis=1).sum() > 1 else None


def faces_in(images: Iterable[np.ndarray], tracker: LandmarkTracker) -> Iterator[Landmarks | None]:
    """The face in every image, each looked at on its own."""
    for image in images:
        tracker.reset()
        yield tracker.landmarks(image)


def scores_of(faces: Iterable[Landmarks | None]) -> Float[np.ndarray, "T 52"]:
    """Scores of faces; NaN where there is none."""
    return np.array([_UNKNOWN if face is None else face.blendshapes for face in faces], np.float64)
