"""`.frame` files as people have them: tensors, no batch axis, other names, no `opencv`, damaged ones among good ones.

Reference: the same clip as metrical-tracker itself writes it. Also covers
`preprocess/formats/frame_files.py`, `preprocess/formats/frame_set.py`, `preprocess/formats/array_table.py`.
"""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.geometry.transforms import matrix_to_axis_angle, rotation_6d_to_matrix
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.importers import metrical_tracker, sheap, vhap_tracked
from preprocess.formats.registry import detect_format
from tests.support.synthetic_clip import moving_record, sheap_record, still_camera

FIELDS = ("intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "shape")


def mapped(value, change):
    if isinstance(value, dict):
        return {name: mapped(item, change) for name, item in value.items()}
    return change(value) if isinstance(value, np.ndarray) and value.dtype.kind == "f" else value


def tensors(content):
    return mapped(content, torch.from_numpy)


def parameters(content):
    return mapped(content, lambda value: torch.nn.Parameter(torch.from_numpy(value)))


def unbatched(content):
    return mapped(content, lambda value: value[0])


def lists(content):
    return mapped(content, lambda value: value.tolist())


def renamed(content):
    flame = {
        {"exp": "expression", "jaw": "jaw_pose", "eyes": "eyes_pose", "eyelids": "eyelid"}.get(name, name): value
        for name, value in content["flame"].items()
    }
    return {"flame": flame, "opencv": content["opencv"], "image_size": content["img_size"]}


def axis_angles(content):
    def converted(rows):
        return matrix_to_axis_angle(rotation_6d_to_matrix(torch.from_numpy(rows).reshape(-1, 6))).reshape(1, -1).numpy()

    flame = dict(content["flame"], jaw=converted(content["flame"]["jaw"]), eyes=converted(content["flame"]["eyes"]))
    return dict(content, flame=flame)


def without_opencv(content):
    return {name: value for name, value in content.items() if name != "opencv"}


VARIANTS = {
    "tensors": (tensors, None),
    "parameters": (parameters, None),
    "no batch axis": (unbatched, "batch axis"),
    "lists": (lists, None),
    "other names": (renamed, "is read as"),
    "axis-angle": (axis_angles, None),
    "without opencv": (without_opencv, "'opencv' is missing"),
    "all of it": (lambda content: tensors(unbatched(without_opencv(content))), "'opencv' is missing"),
}


@pytest.mark.parametrize("zipped", [True, False])
@pytest.mark.parametrize("name", VARIANTS)
def test_variants_mean_the_same(tmp_path, name, zipped):
    change, said = VARIANTS[name]
    record = moving_record(4, (128, 96))
    metrical_tracker.write(tmp_path / "own", record)
    (tmp_path / "changed").mkdir()
    for row in range(4):
        content = change(metrical_tracker.frame_dictionary(record, row))
        torch.save(content, tmp_path / "changed" / f"{row:05d}.frame", _use_new_zipfile_serialization=zipped)
    assert detect_format(tmp_path / "changed") == "metrical_tracker"
    own, found = (metrical_tracker.read(tmp_path / folder) for folder in ("own", "changed"))
    for field in FIELDS:
        np.testing.assert_allclose(getattr(found, field), getattr(own, field), atol=2e-5)
    assert (found.width, found.height) == (128, 96)
    assert any(said in note for note in found.notes) if said else found.notes == own.notes


@pytest.mark.parametrize("suffix", [".frame", ".pt", ".pkl"])
def test_the_content_decides_not_the_name(tmp_path, suffix):
    record = moving_record(3)
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    for row in range(3):
        (folder / f"f_{row}{suffix}").write_bytes(pickle.dumps(metrical_tracker.frame_dictionary(record, row)))
    assert detect_format(tmp_path) == "metrical_tracker"
    assert metrical_tracker.read(tmp_path).numbers.tolist() == [0, 1, 2]
    for path in folder.iterdir():
        path.write_bytes(pickle.dumps({"something": "else"}))
    with pytest.raises(InputError, match="known tracker"):
        detect_format(tmp_path)


@pytest.mark.parametrize("fault", ["cut", "empty", "code", "another size", "fewer expressions", "no jaw"])
def test_one_bad_frame_is_left_out(tmp_path, fault):
    """The first frame is the bad one, so that it can decide neither the format nor the sizes."""
    record = moving_record(5)
    folder = tmp_path / "frames"
    metrical_tracker.write(folder, record)
    path, content = folder / "00000.frame", metrical_tracker.frame_dictionary(record, 0)
    if fault == "cut":
        path.write_bytes(path.read_bytes()[:300])
    elif fault == "empty":
        path.write_bytes(b"")
    elif fault == "code":
        path.write_bytes(b"\x80\x02cos\nsystem\nX\x02\x00\x00\x00id\x85R.")
    elif fault == "another size":
        torch.save(content | {"img_size": np.array([48, 48])}, path)
    elif fault == "fewer expressions":
        torch.save(content | {"flame": content["flame"] | {"exp": np.zeros((1, 50), np.float32)}}, path)
    else:
        del content["flame"]["jaw"]
        torch.save(content, path)
    assert detect_format(folder) == "metrical_tracker"
    found = metrical_tracker.read(folder)
    assert found.numbers.tolist() == [1, 2, 3, 4]
    if fault != "empty":  # an empty file is no pickle and is not counted as a frame
        assert "frame 0 of the tracking cannot be used" in found.notes[0] and "00000.frame" in found.notes[0]
    np.testing.assert_allclose(found.world_to_camera, record.world_to_camera[1:], atol=1e-6)


def test_many_bad_frames_are_refused(tmp_path):
    metrical_tracker.write(tmp_path, moving_record(4))
    for row in range(3):
        (tmp_path / f"{row:05d}.frame").write_bytes(b"\x80\x02cos\nsystem\n.")
    for read in (metrical_tracker.read, detect_format):
        with pytest.raises(InputError, match=r"00000\.frame: refused, since it holds os\.system"):
            read(tmp_path)


def test_content_that_fits_two_formats(tmp_path):
    """Both are named, with what chooses one of them."""
    vhap_tracked.write(tmp_path / "tracked.npz", still_camera(2, (96, 96), 300.0))
    sheap.write(tmp_path / "sheap.npz", sheap_record(2))
    write_npz(tmp_path / "both.npz", read_npz(tmp_path / "tracked.npz") | read_npz(tmp_path / "sheap.npz"))
    with pytest.raises(InputError, match=r"fits 2 formats; choose one .*--format sheap \(.*--format vhap-tracked \("):
        detect_format(tmp_path / "both.npz")


def test_tensors_of_a_users_clip(data_folder):
    """The case that was refused as code that could run; camera and focal length are those of its 128 px clip."""
    folder = data_folder / "cases" / "frames_of_tensors"
    assert detect_format(folder) == "metrical_tracker"
    found = metrical_tracker.read(folder)
    assert len(found.numbers) == 24 and (found.width, found.height) == (128, 128) and found.notes == ()
    np.testing.assert_allclose(found.intrinsics[0], [[294.4, 0, 64], [0, 294.4, 64], [0, 0, 1]], atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(found.world_to_camera[:, :3, 3], axis=1), 1.0, atol=0.05)
