"""Loading tensors by name: both formats, damaged files, and that nothing in them runs."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest
import safetensors.torch
import torch

from ggavatar.errors import InputError
from ggavatar.pretrained import weights
from ggavatar.pretrained.weights import load_weights


def test_both_formats_give_the_same_tensors(tmp_path: Path) -> None:
    state = {"features.0.weight": torch.arange(6.0).reshape(2, 3), "features.0.bias": torch.ones(2)}
    torch.save(state, tmp_path / "a.pth")
    safetensors.torch.save_file(state, tmp_path / "a.safetensors")
    for name in ("a.pth", "a.safetensors"):
        loaded = load_weights(tmp_path / name)
        assert set(loaded) == set(state) and all(torch.equal(loaded[key], state[key]) for key in state)


def test_tensors_only(tmp_path: Path) -> None:
    class Harmful:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "harm"),)

    path = tmp_path / "toy.pth"
    for bad in (pickle.dumps(Harmful(), protocol=2), b"", b"PK nonsense"):
        path.write_bytes(bad)
        with pytest.raises(InputError, match=r"toy\.pth"):
            load_weights(path)
    torch.save([torch.ones(2)], path)
    with pytest.raises(InputError, match="found list"):
        load_weights(path)
    assert not (tmp_path / "harm").exists()


def test_damaged_and_oversized_files_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "toy.safetensors"
    safetensors.torch.save_file({"a": torch.ones(100)}, path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"toy\.safetensors: .*damaged"):
        load_weights(path)
    monkeypatch.setattr(weights, "MAX_WEIGHT_BYTES", 100)
    with pytest.raises(InputError, match="at most"):
        load_weights(path)
