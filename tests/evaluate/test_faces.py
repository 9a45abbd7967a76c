"""Faces: the arithmetic by hand, the detector on a public-domain portrait, the recogniser as a tiny network."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from picture_pairs import write
from skimage.data import astronaut

from evaluate.catalogue import FACES
from evaluate.faces import DETECTORS, RECOGNISERS, FaceMetrics, cosine, jitter, landmark_error
from evaluate.gather import Labels
from evaluate.pairing import pair_folders
from evaluate.protocol import named
from evaluate.score import score
from evaluate.temporal import landmark_jitter
from ggavatar.errors import InputError


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
    """An ONNX file whose embedding of a face is its mean colour (one GlobalAveragePool node)."""
    node = message(1, b"data") + message(2, b"fc1") + message(4, b"GlobalAveragePool")
    graph = message(1, node) + message(2, b"g") + message(11, tensor_info("data", (1, 3, 112, 112)))
    graph += message(12, tensor_info("fc1", (1, 3, 1, 1)))
    path.write_bytes(bytes([8, 7]) + message(7, graph) + message(8, bytes([16, 11])))
    return path


@pytest.fixture
def networks(models_folder: Path, tmp_path: Path) -> Path:
    """A folder with the real detector and the stand-in for the recogniser."""
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / DETECTORS[1]).symlink_to(models_folder / DETECTORS[1])
    mean_color_network(folder / RECOGNISERS[0])
    return folder


@pytest.mark.weights
def test_a_shifted_portrait_has_the_shift_as_its_landmark_distance(networks: Path) -> None:
    truth = astronaut()
    faces = FaceMetrics(FACES, [networks])
    assert faces.missing == {}
    assert len(faces.hashes) == 2
    same = faces.measure(truth, truth)
    assert same.values == {"landmark_distance": 0.0, "identity": pytest.approx(1)}
    moved = faces.measure(np.roll(truth, 32, axis=1), truth)
    assert moved.landmark_error is not None
    eyes = 42.0
    assert moved.values["landmark_distance"] == pytest.approx(32 / eyes, rel=0.15)
    assert moved.landmark_error[:, 0].mean() == pytest.approx(32 / eyes, rel=0.15)


@pytest.mark.weights
def test_likeness_follows_the_embedding(networks: Path) -> None:
    truth = astronaut()
    red = truth.copy()
    red[..., 1:] //= 8
    found = FaceMetrics(["identity"], [networks]).measure(red, truth)
    assert found.values["identity"] < 0.95


@pytest.mark.weights
def test_missed_faces_are_counted_and_never_scored_zero(networks: Path, tmp_path: Path) -> None:
    portrait = astronaut()
    for frame in range(5):
        write(tmp_path / "gt" / f"{frame}.png", portrait)
        write(tmp_path / "pred" / f"{frame}.png", portrait if frame != 1 else np.full_like(portrait, 255))
    pairs = pair_folders(tmp_path / "pred", tmp_path / "gt")
    protocol = named("folders").override(metrics=FACES, table_metrics=FACES[:1])
    found = score(pairs, protocol, Labels("a", "b"), faces=FaceMetrics(FACES, [networks]))
    assert [value is None for value in found.values["landmark_distance"]] == [False, True, False, False, False]
    assert [value is None for value in found.values["landmark_jitter"]] == [True, True, True, True, False]
    assert found.values["landmark_jitter"][4] == 0
    assert found.as_dict()["unmeasured"]["identity"] == [1]
    assert found.summary("landmark_distance").count == 4


def test_without_networks_there_are_reasons(tmp_path: Path) -> None:
    faces = FaceMetrics(FACES, [tmp_path])
    assert set(faces.missing) == set(FACES)
    assert RECOGNISERS[0] in faces.missing["identity"]
    assert faces.measure(astronaut(), astronaut()).values == {}
    (tmp_path / DETECTORS[0]).write_bytes(b"not a network")
    with pytest.raises(InputError, match="YuNet"):
        FaceMetrics(["landmark_distance"], [tmp_path])


def test_jitter_of_single_frames_is_that_of_the_whole_track() -> None:
    random = np.random.default_rng(0)
    truth, render = random.normal(size=(2, 9, 5, 2))
    eyes = np.linalg.norm(truth[:, 0] - truth[:, 1], axis=1)[:, None, None]
    errors = [landmark_error(one, other) for one, other in zip(render, truth, strict=True)]
    found = [jitter(errors[k : k + 3]) for k in range(7)]
    scaled = landmark_jitter(render / eyes, truth / eyes)
    assert np.mean([value for value in found if value is not None]) == pytest.approx(scaled)
    assert jitter([errors[0], None, errors[2]]) is None


def test_cosine_by_hand() -> None:
    assert cosine(np.array([1.0, 0.0]), np.array([1.0, 1.0])) == pytest.approx(np.sqrt(0.5))
    assert cosine(np.array([2.0, 0.0]), np.array([-3.0, 0.0])) == pytest.approx(-1)
    assert cosine(np.zeros(2), np.ones(2)) == 0


def test_the_stand_in_network_is_read_by_opencv(tmp_path: Path) -> None:
    network = cv2.dnn.readNetFromONNX(str(mean_color_network(tmp_path / "n.onnx")))
    network.setInput(np.full((1, 3, 112, 112), 7, np.float32))
    assert network.forward().ravel().tolist() == [7, 7, 7]
