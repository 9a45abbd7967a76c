"""VHAP's combined data sets (UNION), its own results before the export, and damaged time steps.

Reference: vhap/combine_nerf_datasets.py of the project: time steps are counted on from one sequence to the next, paths
become `../SEQUENCE/…`, train and test are two lists; vhap/model/tracker.py `save_result` and its fixed camera. Also
covers `preprocess/formats/importers/vhap.py`, `preprocess/formats/importers/vhap_tracked.py`,
`preprocess/video/listed_images.py`, `ggavatar/io/inner_paths.py`.
"""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from ggavatar.io.inner_paths import path_inside
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.importers import vhap, vhap_tracked
from preprocess.formats.registry import detect_format
from preprocess.tracking.geometry.projection import posed_vertices, project
from preprocess.video.sources import open_source
from tests.support.synthetic_clip import as_tracking, ball_head, still_camera


def posed_by_flame(count, size=(96, 96)):
    """A clip such as VHAP's files can hold."""
    return dataclasses.replace(still_camera(count, size, 3.2 * size[1]), eyelids=np.zeros((count, 2)))


def pixels(record, row):
    record = dataclasses.replace(record, expression=record.expression[:, :4])
    points = posed_vertices(ball_head(), as_tracking(record), row)
    return project(points, record.intrinsics[row], record.world_to_camera[row])[0]


@pytest.mark.parametrize("size", [(96, 96), (128, 96), (96, 128)])
def test_round_trip_keeps_projections(tmp_path, size):
    record = posed_by_flame(5, size)
    path = tmp_path / "tracked_flame_params_30.npz"
    vhap_tracked.write(path, record)
    for place in (path, tmp_path):
        assert detect_format(place) == "vhap_tracked"
        found = vhap_tracked.read(place)
        assert (found.width, found.height, found.version) == (*size, "flame2023")
        for row in range(5):
            np.testing.assert_allclose(pixels(found, row), pixels(record, row), atol=1e-3)


def test_the_content_decides_not_the_name(tmp_path):
    vhap_tracked.write(tmp_path / "mine.bin", posed_by_flame(3))
    assert detect_format(tmp_path / "mine.bin") == "vhap_tracked"


def test_results_of_calibrated_clips_have_no_camera(tmp_path):
    vhap_tracked.write(tmp_path / "tracked.npz", posed_by_flame(3))
    values = read_npz(tmp_path / "tracked.npz")
    del values["focal_length"]
    write_npz(tmp_path / "tracked.npz", values)
    with pytest.raises(InputError, match=r"export_as_nerf_dataset\.py"):
        vhap_tracked.read(tmp_path / "tracked.npz")


def test_frames_are_numbered_by_their_names(tmp_path):
    record = dataclasses.replace(posed_by_flame(3), numbers=np.array([2, 5, 9]))
    vhap_tracked.write(tmp_path / "tracked.npz", record)
    assert vhap_tracked.read(tmp_path / "tracked.npz").numbers.tolist() == [2, 5, 9]
    write_npz(tmp_path / "tracked.npz", read_npz(tmp_path / "tracked.npz") | {"timestep_id": np.array(["a", "b", "c"])})
    found = vhap_tracked.read(tmp_path / "tracked.npz")
    assert found.numbers.tolist() == [0, 1, 2] and "counted from 0" in found.notes[-1]


def make_union(folder, counts=(3, 4, 2), cameras=(0,)):
    """Sequences and the folder that combines them, the last for testing; images are gray by their time step."""
    total, lists = 0, {"train": [], "test": []}
    records = []
    for index, count in enumerate(counts):
        record, name = posed_by_flame(count), f"306_EXP-{index}"
        records.append(record)
        vhap.write(folder / name, record)
        entries = json.loads((folder / name / "transforms.json").read_text())["frames"]
        for row, entry in enumerate(entries):
            write_png(folder / name / entry["file_path"], np.full((96, 96, 3), 10 * (total + row), np.uint8))
            for camera in cameras:
                combined = entry | {"timestep_index": total + row, "camera_index": camera}
                for key in ("file_path", "flame_param_path", "fg_mask_path"):
                    combined[key] = f"../{name}/{entry[key]}"
                lists["test" if index == len(counts) - 1 else "train"].append(combined)
        total += count
    union = folder / "UNION10_306"
    union.mkdir()
    for part, frames in {"train": lists["train"], "val": [], "test": lists["test"]}.items():
        content = {"timestep_indices": list(range(total)), "camera_indices": list(cameras), "frames": frames}
        (union / f"transforms_{part}.json").write_text(json.dumps(content, indent=4))
    return union, records


@pytest.mark.parametrize("cameras", [(0,), (3, 8, 11)])
def test_union_folders(tmp_path, cameras):
    union, records = make_union(tmp_path, cameras=cameras)
    assert detect_format(union) == "vhap"
    found = vhap.read(union)
    assert found.numbers.tolist() == list(range(9)) and found.version == "flame2023"
    assert any("camera 3 of 3" in note for note in found.notes) == (len(cameras) > 1)
    rows = [(record, row) for record in records for row in range(len(record.numbers))]
    for place, (record, row) in enumerate(rows):
        np.testing.assert_allclose(pixels(found, place), pixels(record, row), atol=1e-3)
    frames = list(open_source(union).frames())
    assert [frame.number for frame in frames] == list(range(9))
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [10 * step for step in range(9)]


def test_the_export_itself_is_a_source_of_images(tmp_path):
    make_union(tmp_path)
    assert len(list(open_source(tmp_path / "306_EXP-1").frames())) == 4


OUTSIDE = ["../../secret.npz", "../secret.npz", "../306_EXP-0/../../secret.npz", "../link/secret.npz", "/etc/passwd"]


@pytest.mark.parametrize("target", OUTSIDE)
def test_union_paths_stay_in_the_parent(tmp_path, target):
    """The parent's own files, files above it, and links that lead out of it are refused, by name."""
    place = tmp_path / "data"
    place.mkdir()
    union, _ = make_union(place)
    (tmp_path / "elsewhere").mkdir()
    for secret in (tmp_path / "elsewhere" / "secret.npz", tmp_path / "secret.npz", place / "secret.npz"):
        write_npz(secret, {"a": np.zeros(1)})
    (place / "link").symlink_to(tmp_path / "elsewhere")
    path = union / "transforms_train.json"
    data = json.loads(path.read_text())
    data["frames"][0] |= {"flame_param_path": target, "file_path": target}
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match="a folder beside it"):
        vhap.read(union)
    with pytest.raises(InputError, match="a folder beside it"):
        open_source(union)


def test_names_that_are_none(tmp_path):
    for name in (None, 3, "a\0b", "x" * 2000, ["a"]):
        with pytest.raises(InputError, match="expected a file name"):
            path_inside(tmp_path / "list.json", name)


@pytest.mark.parametrize("fault", ["missing", "damaged", "short", "no matrix"])
def test_one_bad_time_step_is_left_out(tmp_path, fault):
    vhap.write(tmp_path, posed_by_flame(4))
    path = tmp_path / "flame_param" / "00001.npz"
    if fault == "missing":
        path.unlink()
    elif fault == "damaged":
        path.write_bytes(path.read_bytes()[:200])
    elif fault == "short":
        write_npz(path, read_npz(path) | {"jaw_pose": np.zeros((1, 2))})
    else:
        data = json.loads((tmp_path / "transforms.json").read_text())
        data["frames"][1]["transform_matrix"] = [[1, 2], [3, 4]]
        (tmp_path / "transforms.json").write_text(json.dumps(data))
    found = vhap.read(tmp_path)
    assert found.numbers.tolist() == [0, 2, 3] and "frame 1 of the tracking cannot be used" in found.notes[0]
