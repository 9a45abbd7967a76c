"""Where weights are looked for, what is said when they are missing or wrong, and that nothing in them runs."""

from __future__ import annotations

import hashlib
import os
import pickle
from pathlib import Path

import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.pretrained.folders import model_folders
from ggavatar.pretrained.vgg import VGG16, VGG16_TO_RELU2_2, ModelFile, load_weights, locate


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[ModelFile, bytes]:
    """A model file nobody has, and its bytes."""
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("GGAVATAR_MODELS", str(tmp_path / "models"))
    torch.save({"features.0.weight": torch.ones(2)}, tmp_path / "made.pth")
    content = (tmp_path / "made.pth").read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    return ModelFile("toy network", "nested/toy.pth", digest, "CC0-1.0", "https://example.org/toy.pth"), content


def put(folder: Path, model: ModelFile, content: bytes) -> Path:
    path = folder / model.file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_folders_are_searched_in_order(model: tuple[ModelFile, bytes], tmp_path: Path) -> None:
    file, content = model
    own, environment, cache = model_folders(tmp_path / "own")
    assert [own, environment] == [tmp_path / "own", tmp_path / "models"] and cache.is_relative_to(tmp_path / "cache")
    assert locate(file, own) is None
    for folder in (cache, environment, own):
        path = put(folder, file, content)
        assert locate(file, own) == path


def test_damaged_file_is_refused(model: tuple[ModelFile, bytes], tmp_path: Path) -> None:
    file, content = model
    put(tmp_path / "models", file, content[:-1])
    with pytest.raises(InputError, match=r"expected SHA-256 .* found .* get the file again"):
        locate(file)


def test_tensors_only(model: tuple[ModelFile, bytes], tmp_path: Path) -> None:
    path = put(tmp_path / "models", *model)
    assert torch.equal(load_weights(path)["features.0.weight"], torch.ones(2))

    class Harmful:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "harm"),)

    for bad in (pickle.dumps(Harmful(), protocol=2), b"", b"PK nonsense"):
        path.write_bytes(bad)
        with pytest.raises(InputError, match=r"toy\.pth"):
            load_weights(path)
    torch.save([torch.ones(2)], path)
    with pytest.raises(InputError, match="found list"):
        load_weights(path)
    assert not (tmp_path / "harm").exists()


def test_every_known_file_is_fully_described() -> None:
    for known in (VGG16, VGG16_TO_RELU2_2):
        assert len(known.sha256) == 64 and set(known.sha256) <= set("0123456789abcdef")
        assert known.name and known.license and known.source and known.file.endswith(".pth")


@pytest.mark.weights
@pytest.mark.parametrize("known", [VGG16_TO_RELU2_2])
def test_files_at_hand_have_the_digests_we_state(known: ModelFile) -> None:
    path = locate(known)
    if path is None:
        pytest.skip(f"needs {known.file} in $GGAVATAR_MODELS")
    assert load_weights(path)
