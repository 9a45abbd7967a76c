"""EMOCA, EMICA and SMIRK codes as people have them: the names of folders, faces, single files, damaged ones.

Reference: the projection of DECA's family, s (X + tx) and −s (Y + ty) in halves of the 224 px crop. Also covers
`preprocess/formats/importers/deca.py`, `preprocess/formats/importers/emica.py`,
`preprocess/formats/importers/smirk.py`, `preprocess/formats/weak_perspective.py`, `preprocess/formats/array_files.py`.
"""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.io.npz import write_npz
from preprocess.formats.importers import deca, emica, smirk
from preprocess.formats.registry import detect_format, importer
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, weak_perspective


def pixels(record, row):
    record = dataclasses.replace(record, expression=record.expression[:, :4])
    points = posed_vertices(ball_head(), as_tracking(record), row)
    return project(points, record.intrinsics[row], record.world_to_camera[row])[0]


@pytest.mark.parametrize("name", ["deca", "emica", "smirk"])
def test_round_trip_keeps_projections(tmp_path, name):
    record = weak_perspective(4)
    record = dataclasses.replace(record, eyelids=record.eyelids * (name != "emica"))
    importer(name).write(tmp_path / "codes", record)
    assert detect_format(tmp_path / "codes") == name
    found = importer(name).read(tmp_path / "codes")
    for row in range(4):
        np.testing.assert_allclose(pixels(found, row), pixels(record, row), atol=1e-3)


def emoca_folder(place, number=0):
    place.mkdir(parents=True)
    values = {"shape": np.zeros(100), "exp": np.full(50, number), "pose": np.zeros(6), "cam": np.array([8.0, 0, 0])}
    for name, value in (values | {"tex": np.zeros(50), "detail": np.zeros(128)}).items():
        np.save(place / f"{name}.npy", value.astype(np.float32))


@pytest.mark.parametrize("pattern", ["{:06d}_000", "frame_{:04d}", "take2_{:03d}", "{}"])
def test_names_of_folders(tmp_path, pattern):
    for number in (0, 1, 2, 7, 10):
        emoca_folder(tmp_path / pattern.format(number), number)
    found = deca.read(tmp_path)
    assert detect_format(tmp_path) == "deca" and found.numbers.tolist() == [0, 1, 2, 7, 10]
    assert found.expression[:, 0].tolist() == [0, 1, 2, 7, 10]


def test_emoca_codes_of_a_user(data_folder):
    """The case that was read as 1 frame of 10: `000000_000` to `000009_000`."""
    folder = data_folder / "cases" / "emoca_codes"
    found = importer(detect_format(folder)).read(folder)
    assert detect_format(folder) == "deca" and found.numbers.tolist() == list(range(10))


def test_of_several_faces_the_first_is_taken(tmp_path):
    for number, face in ((0, 0), (0, 1), (1, 1), (2, 0)):
        emoca_folder(tmp_path / f"{number:06d}_{face:03d}", 10 * number + face)
    found = deca.read(tmp_path)
    assert found.expression[:, 0].tolist() == [0, 20] and list(found.numbers) == [0, 2]
    assert "0 is used" in found.notes[0]


@pytest.mark.parametrize("fault", ["object", "missing", "scale", "text", "identity"])
def test_one_bad_code_is_left_out(tmp_path, fault):
    for number in range(4):
        emoca_folder(tmp_path / f"{number:06d}_000")
    bad = tmp_path / "000000_000"
    if fault == "object":
        np.save(bad / "exp.npy", np.array([{}], dtype=object))
    elif fault == "missing":
        (bad / "cam.npy").unlink()
    elif fault == "scale":
        np.save(bad / "cam.npy", np.zeros(3))
    elif fault == "identity":
        np.save(bad / "shape.npy", np.full(100, 1e30, np.float32))
    else:
        (bad / "exp.npy").write_text("text")
    found = deca.read(tmp_path)
    assert found.numbers.tolist() == [1, 2, 3] and "frame 0 of the tracking cannot be used" in found.notes[0]


def smirk_output(count):
    generator = np.random.default_rng(0)
    sizes = {"pose_params": 3, "shape_params": 300, "expression_params": 50, "eyelid_params": 2, "jaw_params": 3}
    values = {name: generator.normal(0, 0.1, (count, size)).astype(np.float32) for name, size in sizes.items()}
    return values | {"cam": np.tile(np.array([[8.0, 0.01, -0.02]], np.float32), (count, 1))}


def save(path, kind, values):
    if kind == "npz":
        write_npz(path, values)
    elif kind == "torch":
        torch.save({name: torch.from_numpy(value) for name, value in values.items()}, path)
    else:
        path.write_bytes(pickle.dumps(values))


@pytest.mark.parametrize("kind", ["npz", "torch", "pickle"])
def test_smirk_as_one_file_or_many(tmp_path, kind):
    """The encoder's dictionary of a clip, and of its images one by one, mean the same."""
    values = smirk_output(4)
    save(tmp_path / "clip.bin", kind, values)
    (tmp_path / "images").mkdir()
    for row in range(4):
        save(tmp_path / "images" / f"{row}.bin", kind, {name: value[row : row + 1] for name, value in values.items()})
    one, many = smirk.read(tmp_path / "clip.bin"), smirk.read(tmp_path / "images")
    assert detect_format(tmp_path / "clip.bin") == detect_format(tmp_path / "images") == "smirk"
    np.testing.assert_allclose(one.joint_rotations[:, 0], values["pose_params"])
    np.testing.assert_allclose(one.joint_rotations[:, 2], values["jaw_params"])
    for field in ("world_to_camera", "expression", "joint_rotations", "eyelids", "shape"):
        np.testing.assert_allclose(getattr(one, field), getattr(many, field), atol=1e-6)


def test_a_row_without_a_face_is_left_out(tmp_path):
    values = smirk_output(5)
    values["cam"][3] = 0
    save(tmp_path / "clip.npz", "npz", values)
    assert smirk.read(tmp_path / "clip.npz").numbers.tolist() == [0, 1, 2, 4]
    values["cam"] = values["cam"][:2]
    save(tmp_path / "clip.npz", "npz", values)
    with pytest.raises(InputError, match="as many rows"):
        smirk.read(tmp_path / "clip.npz")


def test_emica_models_are_told_apart_by_their_folder(tmp_path):
    for model, version in (("EMICA-CVT_flame2020_notexture", "flame2020"), ("EMICA_flame2023", "flame2023")):
        emica.write(tmp_path / model, weak_perspective(2))
        assert emica.read(tmp_path / model).version == version
    emica.write(tmp_path / "EMICA_flame2023_no_jaw", weak_perspective(2))
    with pytest.raises(InputError, match="EMICA-CVT_flame2020_notexture"):
        emica.read(tmp_path / "EMICA_flame2023_no_jaw")
