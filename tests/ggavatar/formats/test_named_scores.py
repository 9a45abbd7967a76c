"""MediaPipe's results as recordings of scores. Reference: the layouts of its Python and JavaScript packages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.arkit_recording import ARKIT_NAMES, is_arkit_recording, read_arkit_recording
from ggavatar.formats.named_scores import scores_by_name
from ggavatar.landmarks.blendshapes import NAMES

MEDIAPIPE = ("_neutral", *NAMES[1:])
VALUES = np.random.default_rng(4).uniform(size=(3, 52)).round(3)


def javascript(row: np.ndarray, number: int) -> dict[str, Any]:
    """A frame of FaceLandmarker.detectForVideo in a browser."""
    categories = [
        {"index": index, "score": float(score), "categoryName": name, "displayName": ""}
        for index, (name, score) in enumerate(zip(MEDIAPIPE, row, strict=True))
    ]
    return {"faceBlendshapes": [{"categories": categories, "headIndex": -1}], "timestampMs": 40 * number}


def python(row: np.ndarray, number: int) -> dict[str, Any]:
    """A frame of mediapipe.tasks in Python, its Category objects as dicts."""
    pairs = list(zip(MEDIAPIPE, row, strict=True))[::-1]
    categories = [{"category_name": name, "score": float(score)} for name, score in pairs]
    return {"face_blendshapes": [categories], "timestamp_ms": 40 * number}


def mapping(row: np.ndarray, number: int) -> dict[str, Any]:
    return {"blendshapes": dict(zip(MEDIAPIPE, row.tolist(), strict=True)), "time": 0.04 * number}


def flat(row: np.ndarray, number: int) -> dict[str, Any]:
    return {**dict(zip(MEDIAPIPE, row.tolist(), strict=True)), "time": 0.04 * number}


@pytest.mark.parametrize("layout", [javascript, python, mapping, flat])
@pytest.mark.parametrize("wrapped", [True, False])
def test_scores_are_found_by_name_in_every_layout(layout: Any, wrapped: bool, tmp_path: Path) -> None:
    frames = [layout(row, number) for number, row in enumerate(VALUES)]
    path = tmp_path / "take.json"
    path.write_text(json.dumps({"frames": frames} if wrapped else frames))
    assert is_arkit_recording(path)
    found = read_arkit_recording(path)
    np.testing.assert_allclose(found.times, [0, 0.04, 0.08], atol=1e-9)
    for column, name in enumerate(MEDIAPIPE):
        if name in ARKIT_NAMES:
            np.testing.assert_allclose(found.scores[:, ARKIT_NAMES.index(name)], VALUES[:, column])
    assert found.scores[:, ARKIT_NAMES.index("tongueOut")].max() == 0 and "tongueOut" in found.notes[0]


def test_frames_without_a_face_are_left_out(tmp_path: Path) -> None:
    frames = [javascript(row, number) for number, row in enumerate(VALUES)]
    frames[1]["faceBlendshapes"] = []
    (tmp_path / "take.json").write_text(json.dumps(frames))
    found = read_arkit_recording(tmp_path / "take.json")
    np.testing.assert_allclose(found.times, [0, 0.08], atol=1e-9)
    assert any("1 of 3 rows" in note for note in found.notes)


@pytest.mark.parametrize(
    "text",
    ["[]", "[1, 2]", "[[]]", '[{"faceBlendshapes": 3}]', '[{"jawOpen": "wide"}]', '[{"categories": [{}]}]', "[",
     "[NaN]", '[{"faceBlendshapes": [[[[[{"jawOpen": 1}]]]]]}]'],
)  # fmt: skip
def test_other_lists_are_refused_in_words(text: str, tmp_path: Path) -> None:
    path = tmp_path / "take.json"
    path.write_text(text)
    assert not is_arkit_recording(path)
    with pytest.raises(InputError):
        read_arkit_recording(path)


def test_too_many_names_are_no_recording() -> None:
    assert scores_by_name([{f"name{number}": 0.5} for number in range(201)]) is None
    assert scores_by_name([]) is None
