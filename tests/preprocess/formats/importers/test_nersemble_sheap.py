"""NeRSemble's benchmark tracking and SHeaP's dictionary: their own projections in float64, and our writers.

Reference: nersemble-benchmark `models/flame.py` (scale·R·v + translation, Euler XYZ, OpenCV world-to-camera); SHeaP's
demo.py and render.py (a camera at z = 1 looking along −z, vertical field of view 14.2539°). Also covers
`preprocess/formats/importers/nersemble.py`, `preprocess/formats/importers/sheap.py`.
"""

from __future__ import annotations

import dataclasses
import json
import pickle

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.errors import InputError
from ggavatar.io.npz import read_npz, write_npz
from preprocess.formats.importers import nersemble, sheap
from preprocess.formats.registry import detect_format
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record, sheap_record


def pixels(record, row):
    record = dataclasses.replace(record, expression=record.expression[:, :4])
    points = posed_vertices(ball_head(), as_tracking(record), row)
    return project(points, record.intrinsics[row], record.world_to_camera[row])[0]


def clip(count):
    record = moving_record(count, (512, 512))
    return dataclasses.replace(record, eyelids=np.zeros((count, 2)))


@pytest.mark.parametrize("name", ["nersemble", "sheap"])
def test_round_trip_keeps_projections(tmp_path, name):
    module, record = (nersemble, clip(6)) if name == "nersemble" else (sheap, sheap_record(6))
    module.write(tmp_path / name, record)
    assert detect_format(tmp_path / name) == name
    found = module.read(tmp_path / name)
    for row in range(6):
        np.testing.assert_allclose(pixels(found, row), pixels(record, row), atol=1e-3)


def benchmark(folder, count=4):
    """The benchmark's own tree of one person with four cameras, a scaled head and turns large enough to matter."""
    generator = np.random.default_rng(0)
    angles = generator.normal(0, 0.3, (count, 3))
    arrays = {
        "shape": np.zeros((1, 300)),
        "expression": generator.normal(0, 1, (count, 100)),
        "rotation": angles,
        "rotation_matrices": Rotation.from_euler("XYZ", angles).as_matrix(),
        "translation": generator.normal(0, 0.02, (count, 3)),
        **{"jaw": np.zeros((count, 3)), "neck": np.zeros((count, 3)), "eyes": np.zeros((count, 6))},
        "scale": np.full((1, 1), 0.9),
        "frames": np.arange(0, 3 * count, 3),
    }
    write_npz(folder / "sequences" / "EXP-1-head" / "tracking" / "flame2023_tracking_v2.npz", arrays)
    poses = {}
    for index, serial in enumerate(("222200046", "222200037", "220700191", "222200039")):
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, :3] = Rotation.from_euler("Y", 0.3 * index).as_matrix() @ pose[:3, :3]
        pose[2, 3] = 1.0
        poses[serial] = pose.tolist()
    intrinsics = {serial: [[1200.0, 0, 255 + i], [0, 1200.0, 256], [0, 0, 1]] for i, serial in enumerate(poses)}
    (folder / "calibration").mkdir()
    (folder / "calibration" / "camera_params.json").write_text(
        json.dumps({"world_2_cam": poses, "intrinsics": intrinsics})
    )
    return arrays, poses, intrinsics


def test_the_benchmarks_tree(tmp_path):
    arrays, poses, intrinsics = benchmark(tmp_path / "393")
    sequence = tmp_path / "393" / "sequences" / "EXP-1-head"
    points = np.random.default_rng(1).normal(0, 0.08, (30, 3))
    for place in (sequence, sequence / "tracking", sequence / "tracking" / "flame2023_tracking_v2.npz"):
        assert detect_format(place) == "nersemble"
        found = nersemble.read(place)
        assert (found.width, found.height, found.version) == (512, 512, "flame2023")
        assert any("images/cam_222200037.mp4" in note for note in found.notes)
        assert any("row k is taken as frame k" in note for note in found.notes)
        for row in range(4):
            turn = Rotation.from_euler("XYZ", arrays["rotation"][row]).as_matrix()
            world = 0.9 * points @ turn.T + arrays["translation"][row]
            expected = project(world, np.array(intrinsics["222200037"]), np.array(poses["222200037"]))[0]
            seen = project(points, found.intrinsics[row], found.world_to_camera[row])[0]
            np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_nersemble_faults(tmp_path):
    arrays, _, _ = benchmark(tmp_path / "393")
    path = tmp_path / "393" / "sequences" / "EXP-1-head" / "tracking" / "flame2023_tracking_v2.npz"
    write_npz(path, arrays | {"rotation": Rotation.from_matrix(arrays["rotation_matrices"]).as_rotvec()})
    with pytest.raises(InputError, match="Euler angles"):
        nersemble.read(path)
    translation = arrays["translation"].copy()
    translation[1] = np.nan
    write_npz(path, arrays | {"translation": translation})
    assert nersemble.read(path).numbers.tolist() == [0, 2, 3]
    (tmp_path / "393" / "calibration" / "camera_params.json").rename(tmp_path / "elsewhere.json")
    with pytest.raises(InputError, match=r"put camera_params\.json beside the npz"):
        nersemble.read(path)
    (tmp_path / "elsewhere.json").rename(path.with_name("camera_params.json"))
    assert len(nersemble.read(path).numbers) == 3


def test_intrinsics_shared_by_all_cameras(tmp_path):
    """nersemble-data has one matrix for images of 2200 × 3208 px."""
    benchmark(tmp_path / "393")
    path = tmp_path / "393" / "calibration" / "camera_params.json"
    shared = [[8000.0, 0, 1095], [0, 8000, 1610], [0, 0, 1]]
    path.write_text(json.dumps(json.loads(path.read_text()) | {"intrinsics": shared}))
    found = nersemble.read(tmp_path / "393" / "sequences" / "EXP-1-head")
    assert (found.width, found.height) == (2200, 3208) and found.intrinsics[0].tolist() == shared


def test_sheap_camera_is_that_of_its_renderer(tmp_path):
    sheap.write(tmp_path / "x.npz", sheap_record(2))
    found = sheap.read(tmp_path / "x.npz")
    points = np.random.default_rng(0).normal(0, 0.05, (20, 3))
    depth = 1 - points[:, 2]
    half = np.tan(np.radians(14.2539) / 2)
    expected = 112 * (1 + np.stack((points[:, 0], -points[:, 1]), 1) / depth[:, None] / half)
    np.testing.assert_allclose(project(points, found.intrinsics[0], found.world_to_camera[0])[0], expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["torch", "pickle", "folder"])
def test_sheap_as_people_save_it(tmp_path, kind):
    """Eyelids are stored right first; a folder has one file for every image."""
    record = sheap_record(4)
    sheap.write(tmp_path / "own.npz", record)
    values = read_npz(tmp_path / "own.npz")
    np.testing.assert_allclose(values["eyelids"][:, 0], record.eyelids[:, 1])
    place = tmp_path / "theirs"
    if kind == "torch":
        torch.save({name: torch.from_numpy(value.copy()) for name, value in values.items()}, place)
    elif kind == "pickle":
        place.write_bytes(pickle.dumps(values))
    else:
        for row in range(4):
            write_npz(place / f"{row}.npz", {name: value[row : row + 1] for name, value in values.items()})
    assert detect_format(place) == "sheap"
    own, found = sheap.read(tmp_path / "own.npz"), sheap.read(place)
    for field in ("expression", "joint_rotations", "eyelids", "translation", "shape"):
        np.testing.assert_allclose(getattr(found, field), getattr(own, field), atol=1e-7)


def test_sheap_holds_only_its_own_camera(tmp_path):
    with pytest.raises(InputError, match="only its own camera"):
        sheap.write(tmp_path / "x.npz", moving_record(2))
