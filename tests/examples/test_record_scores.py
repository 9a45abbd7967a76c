"""The example that records scores: a row for every face, which drives avatars. Reference: the scores that it saw."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from examples import record_scores
from ggavatar.formats.arkit_recording import ARKIT_NAMES, read_arkit_recording
from ggavatar.landmarks.blendshapes import NAMES


def test_a_video_becomes_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    video = tmp_path / "me.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (32, 32))
    for number in range(4):
        writer.write(np.full((32, 32, 3), (0, 0, 60 * number), np.uint8))
    writer.release()

    class Tracker:
        def __init__(self, bundle: object) -> None: ...

        def landmarks(self, picture: np.ndarray) -> SimpleNamespace | None:
            red = round(float(picture[..., 0].mean()) / 60)
            return None if red == 1 else SimpleNamespace(blendshapes=np.full(52, red / 10))

    monkeypatch.setattr(record_scores, "LandmarkTracker", Tracker)
    monkeypatch.setattr(record_scores.ModelFinder, "find", lambda *_: tmp_path)
    monkeypatch.setattr(sys, "argv", ["record_scores.py", str(video), "-o", str(tmp_path / "take.csv")])
    record_scores.main()
    found = read_arkit_recording(tmp_path / "take.csv")
    np.testing.assert_allclose(found.times, [0, 0.08, 0.12], atol=1e-6)
    named = [name for name in ARKIT_NAMES if name in NAMES]
    np.testing.assert_allclose(found.scores[:, ARKIT_NAMES.index(named[0])], [0, 0.2, 0.3], atol=1e-6)


def test_no_video_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="none that opens"):
        next(record_scores.frames(str(tmp_path / "missing.mp4")))
