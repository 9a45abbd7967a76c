"""Faces: the arithmetic by hand, the landmarks on a public-domain portrait, the recognizer as a tiny network."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from evaluate.metrics.catalogue import FACES
from evaluate.metrics.faces import BUNDLE, RECOGNIZER, FaceMetrics, alignment_row, cosine, landmark_error
from evaluate.protocols.protocol import protocol_by_name
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import pair_folders
from evaluate.scoring.score import score
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.catalogue import MODELS, Model, Version
from ggavatar.pretrained.resolve import ModelFinder
from tests.support.image_pairs import write


def message(number: int, content: bytes) -> bytes:
    """A length-delimited protocol-buffer field."""
    length, size = len(content), b""
    while length > 127:
        size += bytes([length & 127 | 128])
        length >>= 7
    return bytes([number << 3 | 2]) + size + bytes([length]) + content


def tensor_info(name: str, shape: tuple[int, ...]) -> bytes:
    dimensions = b"".join(message(1, bytes([8, size])) for size in shape)
    return message(1, name.encode()) + message(2, message(1, bytes([8, 1]) + message(2, dimensions)))


def mean_color_network(path: Path) -> Path:
    """An ONNX file whose embedding of a face is its mean color (one GlobalAveragePool node)."""
    node = message(1, b"data") + message(2, b"fc1") + message(4, b"GlobalAveragePool")
    graph = message(1, node) + message(2, b"g") + message(11, tensor_info("data", (1, 3, 112, 112)))
    graph += message(12, tensor_info("fc1", (1, 3, 1, 1)))
    path.write_bytes(bytes([8, 7]) + message(7, graph) + message(8, bytes([16, 11])))
    return path


@pytest.fixture
def networks(pretrained: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModelFinder:
    """The real face landmarker and, under the name of the recognizer, the stand-in for it."""
    pretrained(BUNDLE)
    file = mean_color_network(tmp_path / "stand_in.onnx")
    version = Version((file.name,), sha256_of(file), file.stat().st_size)
    monkeypatch.setitem(MODELS, RECOGNIZER, Model("testing", "none", (version,)))
    return ModelFinder(tmp_path)


OUTER_CORNERS = 60.0
"""Distance between the outer corners of the portrait's eyes, px, read off the image."""


@pytest.mark.weights
def test_a_shifted_portrait_has_the_shift_as_its_landmark_distance_and_an_equal_face(
    networks: ModelFinder,
) -> None:
    truth = astronaut()
    faces = FaceMetrics(FACES, networks)
    assert faces.missing == {}
    assert set(faces.hashes) == {"faces/face_landmarker.task", "faces/stand_in.onnx"}
    same = faces.measure(truth, truth)
    assert same.values == {"landmark_distance": 0.0, "expression_distance": 0.0, "identity": pytest.approx(1)}
    moved = faces.measure(np.roll(truth, 32, axis=1), truth)
    assert moved.landmark_error is not None
    assert moved.landmark_error.shape == (478, 2)
    assert moved.values["landmark_distance"] == pytest.approx(32 / OUTER_CORNERS, rel=0.02)
    assert moved.landmark_error[:, 0].mean() == pytest.approx(32 / OUTER_CORNERS, rel=0.02)
    assert moved.values["expression_distance"] < 0.002


@pytest.mark.weights
def test_an_open_mouth_is_another_expression_and_the_order_of_frames_does_not_matter(networks: ModelFinder) -> None:
    truth = astronaut()
    opened = cv2.ellipse(truth.copy(), (223, 156), (14, 12), 0, 0, 360, (60, 20, 20), -1)
    faces = FaceMetrics(["expression_distance"], networks)
    found = faces.measure(opened, truth).values
    assert set(found) == {"expression_distance"}
    finder = LandmarkTracker(networks.find(BUNDLE))
    scores = []
    for image in (opened, truth):
        finder.reset()
        seen = finder.landmarks(image)
        assert seen is not None
        scores.append({name: float(seen.blendshapes[k]) for k, name in enumerate(NAMES) if name != "neutral"})
    assert scores[0]["mouthLowerDownLeft"] > scores[1]["mouthLowerDownLeft"] + 0.5
    expected = sum(abs(scores[0][name] - scores[1][name]) for name in scores[0]) / 51
    assert found["expression_distance"] == pytest.approx(expected, rel=1e-5)
    assert found["expression_distance"] > 0.03
    faces.measure(np.roll(truth, 90, axis=1), np.roll(truth, 50, axis=0))
    assert faces.measure(opened, truth).values == found


@pytest.mark.weights
def test_faces_are_aligned_by_eyes_nose_and_mouth(networks: ModelFinder) -> None:
    found = LandmarkTracker(networks.find(BUNDLE)).landmarks(astronaut())
    assert found is not None
    row = alignment_row(found.points)
    # Read off the image: the subject's right and left eye, the tip of the nose, the corners of the mouth.
    expected = [[203, 101], [248, 103], [225, 125], [202, 139], [245, 141]]
    np.testing.assert_allclose(row[4:14].reshape(5, 2), expected, atol=4)
    left, top, width, height = row[:4]
    assert left < 200 and top < 100 and left + width > 245 and top + height > 150


@pytest.mark.weights
def test_likeness_follows_the_embedding(networks: ModelFinder) -> None:
    truth = astronaut()
    red = truth.copy()
    red[..., 1:] //= 8
    found = FaceMetrics(["identity"], networks).measure(red, truth)
    assert found.values["identity"] < 0.95


@pytest.mark.weights
def test_missed_faces_are_counted_and_never_scored_zero(networks: ModelFinder, tmp_path: Path) -> None:
    portrait = astronaut()
    for frame in range(5):
        write(tmp_path / "gt" / f"{frame}.png", portrait)
        write(tmp_path / "pred" / f"{frame}.png", portrait if frame != 1 else np.full_like(portrait, 255))
    pairs = pair_folders(tmp_path / "pred", tmp_path / "gt")
    protocol = protocol_by_name("folders").override(metrics=FACES, table_metrics=FACES[:1])
    found = score(pairs, protocol, Labels("a", "b"), faces=FaceMetrics(FACES, networks))
    assert [value is None for value in found.values["landmark_distance"]] == [False, True, False, False, False]
    assert [value is None for value in found.values["landmark_jitter"]] == [True, True, True, True, False]
    assert found.values["landmark_jitter"][4] == 0
    assert found.as_dict()["unmeasured"]["identity"] == [1]
    assert found.summary("landmark_distance").count == 4


def test_without_networks_there_are_reasons(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    faces = FaceMetrics(FACES, ModelFinder(tmp_path))
    assert set(faces.missing) == set(FACES)
    assert all("no weights: model file face_landmarker.task" in reason for reason in faces.missing.values())
    assert faces.measure(astronaut(), astronaut()).values == {}
    (tmp_path / "face_landmarker.task").write_bytes(b"not a network")
    with pytest.raises(InputError, match="refused"):
        FaceMetrics(["landmark_distance"], ModelFinder(tmp_path))


@pytest.mark.weights
def test_without_the_recognizer_the_rest_is_measured(
    pretrained: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pretrained(BUNDLE)
    absent = dataclasses.replace(MODELS[RECOGNIZER].versions[0], files=("nowhere.onnx",))
    monkeypatch.setitem(MODELS, RECOGNIZER, Model("testing", "none", (absent,)))
    faces = FaceMetrics(FACES, ModelFinder())
    assert set(faces.missing) == {"identity"} and "nowhere.onnx" in faces.missing["identity"]
    assert set(faces.measure(astronaut(), astronaut()).values) == {"landmark_distance", "expression_distance"}


def test_cosine_by_hand() -> None:
    assert cosine(np.array([1.0, 0.0]), np.array([1.0, 1.0])) == pytest.approx(np.sqrt(0.5))
    assert cosine(np.array([2.0, 0.0]), np.array([-3.0, 0.0])) == pytest.approx(-1)
    assert cosine(np.zeros(2), np.ones(2)) == 0


def test_the_stand_in_network_is_read_by_opencv(tmp_path: Path) -> None:
    network = cv2.dnn.readNetFromONNX(str(mean_color_network(tmp_path / "n.onnx")))
    network.setInput(np.full((1, 3, 112, 112), 7, np.float32))
    assert network.forward().ravel().tolist() == [7, 7, 7]


def test_landmark_error_is_in_eye_distances() -> None:
    """33 and 263 are the outer corners in MediaPipe's mesh of the face."""
    truth = np.zeros((478, 2))
    truth[33], truth[263] = (10.0, 5.0), (40.0, 45.0)
    assert landmark_error(truth + np.array([10.0, -5.0]), truth)[7].tolist() == [0.2, -0.1]
