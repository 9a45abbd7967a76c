"""`head.npz`: round trip, and every way in which a file can be wrong.

Also covers `ggavatar/head/array_shapes.py`.
"""

from __future__ import annotations

import io
import pickle
import zipfile

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.head.files import load_head, save_head
from ggavatar.head.model import HeadModel
from ggavatar.io import npz as array_files


def small_head(uv: bool = True) -> HeadModel:
    generator = torch.Generator().manual_seed(0)

    def drawn(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    return HeadModel(
        template=drawn(4, 3),
        faces=torch.tensor([[0, 1, 2], [0, 2, 3]]),
        expression_basis=drawn(4, 3, 2),
        pose_basis=torch.zeros(4, 3, 9),
        eyelid_basis=drawn(4, 3, 2),
        joint_regressor=drawn(2, 4),
        skinning_weights=torch.full((4, 2), 0.5),
        parents=(-1, 0),
        joint_names=("root", "neck"),
        version="test-1",
        regions={"face": torch.tensor([0, 2])},
        uv=drawn(2, 3, 2) if uv else None,
    )


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "a folder" / "head.npz"
    path.parent.mkdir()
    save_head(small_head(), path)
    with np.load(path, allow_pickle=False) as archive:
        return path, {key: archive[key] for key in archive.files}


@pytest.mark.parametrize("uv", [True, False])
def test_round_trip(tmp_path, uv):
    head = small_head(uv)
    save_head(head, tmp_path / "head.npz")
    again = load_head(tmp_path / "head.npz")
    for name in ("template", "faces", "expression_basis", "pose_basis", "eyelid_basis", "joint_regressor"):
        assert torch.equal(getattr(again, name), getattr(head, name)), name
    assert (again.parents, again.joint_names, again.version) == (head.parents, head.joint_names, head.version)
    assert torch.equal(again.regions["face"], head.regions["face"])
    assert (again.uv is None) == (head.uv is None)
    assert list(tmp_path.iterdir()) == [tmp_path / "head.npz"]


BROKEN = {
    "template": np.zeros((4, 2)),
    "faces": np.array([[0, 1, 4]]),
    "expression_basis": np.full((4, 3, 2), np.nan),
    "pose_basis": np.zeros((4, 3, 5)),
    "eyelid_basis": np.zeros((4, 3, 1)),
    "joint_regressor": np.zeros((2, 3)),
    "skinning_weights": np.full((4, 2), 0.4),
    "parents": np.array([0, -1]),
    "joint_names": np.array(["root", "root"]),
    "version": np.array(3),
    "region/face": np.array([-1]),
    "uv": np.zeros((1, 3, 2)),
}


@pytest.mark.parametrize("key", list(BROKEN))
def test_a_wrong_array_is_refused_by_file_and_key(stored, key):
    path, arrays = stored
    np.savez(path, **(arrays | {key: BROKEN[key]}))
    with pytest.raises(InputError) as caught:
        load_head(path)
    assert str(path) in str(caught.value) and key in str(caught.value)


def test_a_missing_key_is_named(stored):
    path, arrays = stored
    arrays.pop("eyelid_basis")
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="eyelid_basis"):
        load_head(path)


def test_pickled_objects_are_refused(stored):
    path, arrays = stored
    np.savez(path, allow_pickle=True, **(arrays | {"template": np.array([{"a": 1}], dtype=object)}))
    with pytest.raises(InputError, match="objects"):
        load_head(path)


@pytest.mark.parametrize("content", [b"", b"not an archive", pickle.dumps({"a": 1})])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "head.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"head\.npz"):
        load_head(path)


def test_no_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="nothing"):
        load_head(tmp_path / "none.npz")
    with pytest.raises(InputError, match="a folder"):
        load_head(tmp_path)


def test_declared_sizes_are_limited_before_reading(stored, monkeypatch):
    path, _ = stored
    monkeypatch.setattr(array_files, "MAX_ARCHIVE_BYTES", 100)
    with pytest.raises(InputError, match="the limit is"):
        load_head(path)


def test_truncated_file_is_refused(stored):
    path, _ = stored
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError):
        load_head(path)


def test_entry_that_is_not_an_array_is_refused(stored):
    path, arrays = stored
    arrays.pop("uv")
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr("uv.npy", b"garbage")
    path.write_bytes(buffer.getvalue())
    with pytest.raises(InputError, match="uv"):
        load_head(path)
