"""Landmarks of the face in the images of a clip, or in a few of them, if the networks are on this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ggavatar.landmarks.networks import FaceNetworkFiles
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.resolve import ModelUnavailable, resolve_with_substitutes

GIVE_UP_AFTER = 3
"""Images without a face after which a clip is taken to show none that the network can see; searching them is slow."""


def open_landmark_tracker(models: Path | None, offline: bool) -> LandmarkTracker:
    """The landmark networks: from the bundle, or their substitutes where it is not available.

    Raises:
        ModelUnavailable: Neither is available.
    """
    found = resolve_with_substitutes("face_landmarker", models, offline)
    return LandmarkTracker(found[0] if len(found) == 1 else FaceNetworkFiles(*found))


def local_landmark_tracker(models: Path | None = None) -> LandmarkTracker | None:
    """The landmark networks if they are on this machine, else None; nothing is downloaded."""
    try:
        return open_landmark_tracker(models, offline=True)
    except ModelUnavailable:
        return None


def faces_in_some(
    tracker: LandmarkTracker | None, numbers: Sequence[int], image: Callable[[int], np.ndarray]
) -> dict[int, Float[np.ndarray, "478 2"]]:
    """Landmarks by frame in a few frames, px; empty without networks or if the first images show no face.

    Args:
        tracker: The networks, or None.
        numbers: The frames to look at, each on its own.
        image: Reads a frame.
    """
    found: dict[int, np.ndarray] = {}
    for place, number in enumerate(numbers if tracker is not None else ()):
        assert tracker is not None
        tracker.reset()
        face = tracker.landmarks(image(number))
        if face is not None:
            found[number] = face.points
        elif not found and place + 1 >= GIVE_UP_AFTER:
            break
    return found
