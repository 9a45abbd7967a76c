"""Frames of a JSON recording that name their own scores, as MediaPipe's face landmarker returns them.

A frame is one of
    {"faceBlendshapes": [{"categories": [{"categoryName": "jawOpen", "score": 0.3}, …]}], "timestampMs": 40}
    {"face_blendshapes": [[{"category_name": "jawOpen", "score": 0.3}, …]], "timestamp_ms": 40}
    {"blendshapes": {"jawOpen": 0.3, …}, "time": 0.04}
    {"jawOpen": 0.3, …, "time": 0.04}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

TIMES = {"time": 1.0, "timestamp": 1.0, "timestampms": 1e-3, "timems": 1e-3}
"""Names of a frame's time, in small letters without underscores, and their unit, s."""
MAX_NAMES, MAX_SCORES = 200, 14_000_000
"""An hour at 60 frames per second has 11 million scores."""
_LISTS = ("faceblendshapes", "blendshapes", "categories", "scores")


def scores_by_name(
    frames: Sequence[Any],
) -> tuple[tuple[str, ...], Float[np.ndarray, "T N"], Float[np.ndarray, " T"]] | None:
    """Names, scores (NaN where a frame lacks one, or shows no face) and times (NaN where unknown, s) of frames.

    None if no frame names a score, or more are named than a recording has.
    """
    found = [_scores(frame) for frame in frames]
    names = tuple(dict.fromkeys(name for scores in found for name in scores))
    if not names or len(names) > MAX_NAMES or len(names) * len(found) > MAX_SCORES:
        return None
    values = np.array([[scores.get(name, np.nan) for name in names] for scores in found])
    return names, values, np.array([_time(frame) for frame in frames])


def _scores(frame: Any) -> dict[str, float]:
    """The scores of the first face in a frame."""
    if isinstance(frame, Mapping):
        inner = next((value for key, value in frame.items() if _plain(key) in _LISTS), None)
        if isinstance(inner, Mapping | list):
            return _scores(inner)
        return {key: float(value) for key, value in frame.items() if _is_score(value) and _plain(key) not in TIMES}
    if isinstance(frame, list) and frame and isinstance(frame[0], Mapping):
        named = {}
        for item in frame:
            name = next((item[key] for key in ("categoryName", "category_name") if key in item), None)
            if isinstance(name, str) and _is_score(item.get("score")):
                named[name] = float(item["score"])
        return named or _scores(frame[0])
    if isinstance(frame, list) and frame and isinstance(frame[0], list):
        return _scores(frame[0]) if frame[0] and isinstance(frame[0][0], Mapping) else {}
    return {}


def _time(frame: Any) -> float:
    if isinstance(frame, Mapping):
        for key, value in frame.items():
            if _plain(key) in TIMES and _is_score(value):
                return float(value) * TIMES[_plain(key)]
    return float("nan")


def _plain(key: str) -> str:
    return key.replace("_", "").lower()


def _is_score(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e15
