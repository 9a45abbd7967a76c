"""Which of several people in view a capture is of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ggavatar.landmarks.detector import FaceBox

MAX_STEP = 1.5
"""Farthest that a face moves between two frames that are looked at, in sides of its box."""
MIN_PRESENCE = 0.2
"""Fraction of the frames looked at in which another person must be in view to be mentioned."""
MIN_SCORE = 0.7
"""Median confidence from which another person is one, and not a pattern that resembles a face."""


def follow_one(frames: Sequence[Sequence[FaceBox]]) -> tuple[list[FaceBox], list[list[FaceBox]]]:
    """The faces of the person who is in view most and largest, and those of everybody else who is in view often.

    Args:
        frames: All faces of some frames, in order.
    """
    tracks: list[list[FaceBox]] = []
    for faces in frames:
        free = list(tracks)
        for face in sorted(faces, key=lambda box: -box.side):
            near = [track for track in free if _distance(track[-1], face) <= MAX_STEP * track[-1].side]
            if near:
                nearest = min(near, key=lambda track: _distance(track[-1], face))
                nearest.append(face)
                free.remove(nearest)
            else:
                tracks.append([face])
    if not tracks:
        return [], []
    followed = max(tracks, key=lambda track: sum(face.side for face in track))
    often = max(2.0, MIN_PRESENCE * len(frames))
    others = [track for track in tracks if track is not followed and len(track) >= often]
    return followed, [track for track in others if np.median([face.score for face in track]) >= MIN_SCORE]


def _distance(first: FaceBox, second: FaceBox) -> float:
    return float(np.hypot(first.center[0] - second.center[0], first.center[1] - second.center[1]))


def describe_others(
    followed: Sequence[FaceBox], others: Sequence[Sequence[FaceBox]], looked_at: int, size: tuple[int, int]
) -> str:
    """That there are several people, who is followed, and how to choose another one.

    Args:
        followed: Faces of the person that is followed.
        others: Faces of the others.
        looked_at: Number of frames looked at.
        size: Width and height of the video, px.
    """
    x, y = np.median([face.center for face in followed], axis=0)
    other = max(others, key=len)
    other_x, other_y = np.median([face.center for face in other], axis=0)
    side = "left" if x < other_x else "right"
    half = 1.5 * float(np.median([face.side for face in other]))
    left, top = (max(0, round(value - half)) for value in (other_x, other_y))
    width, height = (min(round(2 * half), limit - low) for low, limit in zip((left, top), size, strict=True))
    square = min(width, height)
    return (
        f"{1 + len(others)} people are in view, another one in {len(other)} of {looked_at} frames looked at: the "
        f"one on the {side}, whose face is around x {x:.0f}, y {y:.0f}, is followed; for the other one add "
        f"--resume --crop {left},{top},{square},{square}"
    )
