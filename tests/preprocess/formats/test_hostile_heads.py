"""Seeded mutations of head models and of whole captures, as `test_hostile_inputs.py` has them of everything else.

A mutated number may still be a number; so what is read must be refused by name or be sound enough to pose.
"""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.data.capture import DESCRIPTION, HEAD, TRACKING, Capture
from ggavatar.data.splits import Split
from ggavatar.errors import InputError
from ggavatar.head.files import load_head, save_head
from ggavatar.head.flame import load_flame
from preprocess.tracking.face.flame_fit import EMBEDDING_FILE, read_embedding
from tests.support.damaged_files import COUNT, ODD_VALUES, refused_mutants
from tests.support.flame_files import flame_values, write_model
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record


def uncompressed(path: Path) -> bytes:
    """The same npz without compression, so that flipped bytes reach numbers and shapes."""
    with np.load(path) as stored:
        arrays = {key: stored[key] for key in stored.files}
    np.savez(path, **arrays)
    return path.read_bytes()


def test_head(tmp_path: Path) -> None:
    path = tmp_path / "head.npz"
    save_head(ball_head(), path)
    original = path.read_bytes()

    def read() -> None:
        head = load_head(path)
        assert torch.isfinite(head.template).all()
        head.vertices(head.neutral_drive())

    assert refused_mutants(path, original, read, 1, COUNT // 2) > COUNT // 5
    path.write_bytes(original)
    assert refused_mutants(path, uncompressed(path), read, 2, COUNT // 2) > COUNT // 10


@pytest.mark.parametrize("kind", ["pkl", "npz"])
def test_flame(tmp_path: Path, kind: str) -> None:
    path, values = tmp_path / f"generic_model.{kind}", flame_values()
    values["shapedirs"] = values["shapedirs"][:, :, :320]
    write_model(path, values) if kind == "pkl" else np.savez(path, **values)

    def read() -> None:
        head = load_flame(path)
        head.vertices(head.neutral_drive())

    assert refused_mutants(path, path.read_bytes(), read, 3) > COUNT // 10


def test_embedding(tmp_path: Path) -> None:
    path = tmp_path / EMBEDDING_FILE
    keys = {"lmk_face_idx": np.arange(20), "lmk_b_coords": np.full((20, 3), 1 / 3), "landmark_indices": np.arange(20)}
    np.savez(path, **keys)
    assert refused_mutants(path, path.read_bytes(), lambda: read_embedding(path, ball_head()), 4) > COUNT // 10


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small capture."""
    head, record = ball_head(), moving_record(4, (64, 64))
    save_head(head, tmp_path / "made.npz")
    with np.load(tmp_path / "made.npz") as arrays:
        stored = {name: arrays[name] for name in arrays.files}
    numbers = tuple(range(4))
    splits = {"every-20th": Split((1, 2, 3), (0,))}
    capture = Capture(tmp_path / "capture", "ball", 64, 64, 25.0, numbers, splits, as_tracking(record), head.version)
    image = np.zeros((64, 64, 3), np.uint8)
    capture.write(((image, image[..., 0]) for _ in numbers), stored)
    return tmp_path / "capture"


@pytest.mark.parametrize("name", [DESCRIPTION, TRACKING, HEAD, "images/000001.png", "masks/000001.png"])
def test_capture(folder: Path, name: str) -> None:
    path = folder / name
    original = uncompressed(path) if name == TRACKING else path.read_bytes()

    def read() -> None:
        capture = Capture.open(folder)
        load_head(capture.head_path)
        for number in capture.frames:
            capture.image(number), capture.mask(number)

    read()
    assert refused_mutants(path, original, read, 5) > COUNT // 10


def test_capture_values(folder: Path) -> None:
    """Any value of capture.json replaced by something odd."""
    path, generator, refused = folder / DESCRIPTION, random.Random(6), 0
    original = path.read_text()
    for _ in range(COUNT):
        data = json.loads(original)
        spot, key = data, generator.choice(list(data))
        while isinstance(spot[key], dict | list) and spot[key] and generator.random() < 0.6:
            spot = spot[key]
            key = generator.choice(list(spot)) if isinstance(spot, dict) else generator.randrange(len(spot))
        spot[key] = generator.choice(ODD_VALUES)
        path.write_text(json.dumps(data))
        try:
            Capture.open(folder)
        except InputError as error:
            refused += 1
            assert path.name in str(error) or str(folder) in str(error)
    assert refused > COUNT // 4
