"""Who is followed. Reference: the drawn-up positions of the faces."""

from __future__ import annotations

from ggavatar.landmarks.detector import FaceBox
from preprocess.evidence.people import describe_others, follow_one


def box(x, y=100, side=60):
    return FaceBox((float(x), float(y)), float(side), 0.0, 0.9)


def test_the_larger_one_is_followed_whatever_the_order():
    frames = [[box(300 - row, side=50), box(100 + row, side=70)][:: 1 if row % 2 else -1] for row in range(6)]
    followed, others = follow_one(frames)
    assert [face.center[0] for face in followed] == [100 + row for row in range(6)]
    assert [len(track) for track in others] == [6]
    message = describe_others(followed, others, 6, (640, 360))
    assert "2 people are in view, another one in 6 of 6 frames" in message
    assert "the one on the left, whose face is around x 102, y 100, is followed" in message
    assert "--resume --crop 222,25,150,150" in message


def test_a_pattern_that_resembles_a_face_is_nobody():
    pattern = FaceBox((400.0, 100.0), 40.0, 0.0, 0.55)
    assert follow_one([[box(100), pattern] for _ in range(5)])[1] == []


def test_somebody_who_passes_is_not_mentioned():
    frames = [[box(100)] for _ in range(9)] + [[box(100), box(400)]]
    followed, others = follow_one(frames)
    assert len(followed) == 10 and others == []
    assert follow_one([]) == ([], []) and follow_one([[], []]) == ([], [])
