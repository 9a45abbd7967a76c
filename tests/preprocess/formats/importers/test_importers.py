"""Every foreign format: written from a known tracking and read back, points project to the same pixels (1e-3 px).

Also covers `preprocess/formats/importers/insta.py`, `preprocess/formats/importers/npz.py`.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from preprocess.formats.importers import deca, imavatar, metrical_tracker, nerface, nerfblendshape, vhap
from preprocess.formats.json_fields import listed_numbers
from preprocess.formats.registry import detect_format, importer, importer_names
from preprocess.options import PrepOptions
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record, weak_perspective

FLAME_FORMATS = ["imavatar", "insta", "metrical_tracker", "npz", "vhap"]
OWN_SPACE = ["nerface", "nerfblendshape"]


def written(name, tmp_path, record):
    folder = tmp_path / ("tracking.npz" if name == "npz" else name)
    importer(name).write(folder, record)
    if name == "nerface":
        write_png(folder / "train" / "f_0000.png", np.zeros((record.height, record.width, 3), np.uint8))
    return folder


def pixels(record, row, head):
    tracking = as_tracking(record)
    tracking = dataclasses.replace(tracking, expression=tracking.expression[:, : head.expression_basis.shape[2]])
    points = posed_vertices(head, tracking, row)
    return project(points, record.intrinsics[row], record.world_to_camera[row])[0]


def posed_by_flame(record):
    """The same record with the head moved by FLAME's root and translation, as VHAP and IMavatar have it."""
    joints = record.joint_rotations.copy()
    joints[:, 0] = [[0.1, 0.2 * np.sin(row), 0.05] for row in range(len(joints))]
    joints[:, 1] = [0.02, -0.1, 0.0]
    moved = np.array([[0.01 * np.cos(row), 0.002 * row, 0.0] for row in range(len(joints))])
    return dataclasses.replace(record, joint_rotations=joints, translation=moved)


def test_every_format_is_tested():
    """Formats that are not in the lists here have a test file with a round trip of their own."""
    here = Path(__file__).parent
    texts = {path: path.read_text() for path in here.glob("test_*.py") if path.name != "test_importers.py"}
    for name in set(importer_names()) - {*FLAME_FORMATS, *OWN_SPACE}:
        files = [text for path, text in texts.items() if name in path.name or f"importers/{name}.py" in text]
        assert any("def test_round_trip_keeps_projections" in text for text in files), name


def test_deca_codes(tmp_path):
    """Reference: its own projection, s (X + tx) and −s (Y + ty) in halves of the 224 px crop.

    The lens stands for infinity.
    """
    record = weak_perspective(4)
    deca.write(tmp_path / "codes", record)
    assert detect_format(tmp_path / "codes") == "deca"
    found = deca.read(tmp_path / "codes")
    np.testing.assert_allclose(found.expression, record.expression)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (30, 3)) * [1, 1, 0]
    for row in range(4):
        np.testing.assert_allclose(pixels(found, row, ball_head()), pixels(record, row, ball_head()), atol=1e-3)
        scale, x, y = np.load(tmp_path / "codes" / f"{row:05d}.npz")["cam"]
        expected = 112 * (1 + scale * (points[:, :2] + [x, y]) * [1, -1])
        seen, _ = project(points, found.intrinsics[row], found.world_to_camera[row])
        np.testing.assert_allclose(seen, expected, atol=1e-6)


@pytest.mark.parametrize("size", [(96, 96), (128, 96)])
@pytest.mark.parametrize("name", FLAME_FORMATS + OWN_SPACE)
def test_round_trip_keeps_projections(name, size, tmp_path):
    head, record = ball_head(), moving_record(6, size)
    if name in ("vhap", "imavatar", "npz"):
        record = posed_by_flame(record)
    if name in OWN_SPACE:
        record = dataclasses.replace(record, joint_rotations=np.zeros_like(record.joint_rotations))
    if name in ("imavatar", "vhap", *OWN_SPACE):
        record = dataclasses.replace(record, eyelids=np.zeros_like(record.eyelids))
    folder = written(name, tmp_path, record)
    assert detect_format(folder) == name
    found = importer(name).read(folder)
    found = dataclasses.replace(found, expression=found.expression[:, :4]) if found.expression.shape[1] > 4 else found
    scale = np.array([size[0] / found.width, size[1] / found.height])
    assert len(found.numbers) == 6
    for row in range(6):
        np.testing.assert_allclose(pixels(found, row, head) * scale, pixels(record, row, head), atol=1e-3)


def test_metrical_tracker_needs_the_eyelids_and_writes_height_first(tmp_path):
    record = moving_record(3, (128, 96))
    folder = written("metrical_tracker", tmp_path, record)
    frame = torch.load(folder / "00001.frame", weights_only=False)
    assert frame["img_size"].tolist() == [96, 128] and frame["frame_id"] == "00001"
    assert frame["flame"]["eyes"].shape == (1, 12) and frame["flame"]["exp"].shape == (1, 100)
    np.testing.assert_allclose(metrical_tracker.read(folder).eyelids, record.eyelids, atol=1e-6)


def test_metrical_tracker_camera_is_pytorch3d(tmp_path):
    """Reference: PyTorch3D's definition, row vectors X·R + T with +X left, +Y up, NDC over half the shorter side."""
    record = moving_record(1, (128, 96))
    frame = torch.load(written("metrical_tracker", tmp_path, record) / "00000.frame", weights_only=False)
    camera = frame["camera"]
    rows = camera["R"].reshape(2, 3).astype(np.float64)
    rotation = np.stack((rows[0], rows[1], np.cross(rows[0], rows[1])))
    points = np.random.default_rng(0).normal(0, 0.1, (20, 3))
    seen = points @ rotation + camera["t"]
    ndc = camera["fl"] * seen[:, :2] / seen[:, 2:] + camera["pp"]
    expected, _ = project(points, record.intrinsics[0], record.world_to_camera[0])
    np.testing.assert_allclose(np.array([64.0, 48.0]) - ndc * 48, expected, atol=1e-3)


def test_metrical_tracker_reads_files_of_numpy_1(tmp_path):
    """Old numpy pickles arrays as numpy.core.multiarray; the renamed module must not be imported for it."""
    folder = written("metrical_tracker", tmp_path, moving_record(2))
    for path in folder.iterdir():
        import zipfile

        with zipfile.ZipFile(path) as archive:
            parts = {info.filename: archive.read(info) for info in archive.infolist()}
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in parts.items():
                archive.writestr(name, data.replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    assert len(metrical_tracker.read(folder).numbers) == 2


def test_eyes_are_in_joint_order(tmp_path):
    record = moving_record(2)
    record.joint_rotations[:, 3, 1], record.joint_rotations[:, 4, 1] = 0.3, -0.1
    found = metrical_tracker.read(written("metrical_tracker", tmp_path, record))
    np.testing.assert_allclose(found.joint_rotations[:, 3, 1], 0.3, atol=1e-6)


def test_vhap_keeps_static_offsets_and_reads_the_first_camera(tmp_path):
    record = moving_record(4)
    offset = np.random.default_rng(0).normal(0, 0.001, (5143, 3))
    folder = written("vhap", tmp_path, dataclasses.replace(record, extra={"static_offset": offset}))
    data = json.loads((folder / "transforms.json").read_text())
    second = [dict(frame, camera_index=1, fl_x=1.0) for frame in data["frames"]]
    (folder / "transforms.json").write_text(json.dumps({"frames": second + data["frames"]}))
    found = vhap.read(folder)
    np.testing.assert_allclose(found.extra["static_offset"], offset, atol=1e-6)
    np.testing.assert_allclose(found.intrinsics, record.intrinsics)
    assert found.version == "flame2023" and any("camera" in note for note in found.notes)


def test_real_vhap_files_are_read(data_folder):
    for subject in ("253", "460"):
        path = data_folder / "tracking" / "vhap_nersemble" / subject / "flame_param" / "00000.npz"
        values = vhap.parameters(path, lambda _: None)
        assert values["shape"].shape == (300,) and values["expression"].shape == (100,)
        assert vhap._static_offset(path)["static_offset"].shape == (5143, 3)
        assert np.abs(values["joint_rotations"]).max() < np.pi


def test_imavatar_traps(tmp_path):
    """×4 lengths, negative fx, numbers from 1, and the older files' pixels of a 512 image."""
    record = moving_record(3)
    folder = written("imavatar", tmp_path, record)
    path = folder / "flame_params.json"
    data = json.loads(path.read_text())
    assert data["intrinsics"][0] < 0 and data["frames"][0]["file_path"] == "./image/1"
    assert data["frames"][0]["world_mat"][2][3] == pytest.approx(-4.0)
    data["intrinsics"] = [value * 512 for value in data["intrinsics"]]
    path.write_text(json.dumps(data))
    np.testing.assert_allclose(imavatar.read(folder).intrinsics[0, 0, 0], record.intrinsics[0, 0, 0] * 512 / 96)


def test_own_spaces_say_so(tmp_path):
    record = dataclasses.replace(moving_record(8), joint_rotations=np.zeros((8, 5, 3)))
    for module, name in ((nerface, "nerface"), (nerfblendshape, "nerfblendshape")):
        found = module.read(written(name, tmp_path, record))
        assert found.version is None and "not FLAME" in found.notes[0]


def test_real_nerf_poses_are_rigid_and_in_front(data_folder):
    """AD-NeRF's file has NeRFBlendShape's cameras; coefficients are added to make the format complete."""
    source = json.loads((data_folder / "tracking" / "adnerf_transforms_val.json").read_text())
    from preprocess.formats.json_fields import pose_from_opengl

    for frame in source["frames"][::50]:
        pose = pose_from_opengl(np.array(frame["transform_matrix"]))
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4)
        assert pose[2, 3] > 0


@pytest.mark.parametrize("name", ["metrical_tracker", "insta"])
def test_formats_without_head_pose_refuse_it(name, tmp_path):
    with pytest.raises(InputError, match="move them into the camera"):
        importer(name).write(tmp_path / "x", posed_by_flame(moving_record(2)))


def test_unknown_format_lists_all(tmp_path):
    with pytest.raises(InputError, match="metrical_tracker, nerface"):
        importer("openpose")
    with pytest.raises(InputError, match="output of a known tracker"):
        detect_format(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        detect_format(tmp_path / "absent")


@pytest.mark.parametrize("target", ["../../../etc/passwd", "/etc/passwd", "flame_param/../../secret.npz"])
def test_paths_in_json_stay_inside(target, tmp_path):
    folder = written("vhap", tmp_path, moving_record(3))
    data = json.loads((folder / "transforms.json").read_text())
    data["frames"][0]["flame_param_path"] = target
    (folder / "transforms.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match="within its own folder"):
        vhap.read(folder)


def test_a_frame_with_nan_is_left_out(tmp_path):
    """One bad frame of four: it is named; three of four: the clip is refused."""
    record = moving_record(4)
    record.world_to_camera[2, 0, 3] = np.nan
    folder = tmp_path / "nan"
    metrical_tracker.write(folder, record)
    found = metrical_tracker.read(folder)
    assert found.numbers.tolist() == [0, 1, 3] and "00002.frame: world_to_camera is NaN" in found.notes[0]
    record.world_to_camera[:3, 0, 3] = np.inf
    metrical_tracker.write(folder, record)
    with pytest.raises(InputError, match=r"00000\.frame: world_to_camera is NaN, infinite or above 10⁶ in magnitude"):
        metrical_tracker.read(folder)


def test_a_row_with_nan_is_left_out(tmp_path):
    """The same for formats with all frames in one file."""
    record = moving_record(4)
    record.expression[1, 2] = np.nan
    importer("npz").write(tmp_path / "x.npz", record)
    found = importer("npz").read(tmp_path / "x.npz")
    assert found.numbers.tolist() == [0, 2, 3] and "frame 1 of the tracking cannot be used" in found.notes[0]
    record.expression[1] = 1e7
    importer("npz").write(tmp_path / "x.npz", record)
    found = importer("npz").read(tmp_path / "x.npz")
    assert found.numbers.tolist() == [0, 2, 3] and "expression of frame 1 is NaN, infinite or above" in found.notes[0]
    record.expression[:3] = 1e7
    importer("npz").write(tmp_path / "x.npz", record)
    with pytest.raises(InputError, match=r"expression of frame 0 is NaN, .* and so in 3 of 4 frames"):
        importer("npz").read(tmp_path / "x.npz")


def test_options_swap_the_size(tmp_path):
    from preprocess.formats.registry import read_tracking_record

    folder = written("metrical_tracker", tmp_path, moving_record(2, (128, 96)))
    options = PrepOptions(tmp_path, tmp_path / "o", tracking=folder, fix=("swapped-size",))
    assert (read_tracking_record(options)[1].width, read_tracking_record(options)[1].height) == (96, 128)


def test_listed_names_follow_the_one_rule_for_numbers(tmp_path):
    """Two cameras listed in one file: the last digits of a name used to be the frame, so that cameras mixed."""
    names = [f"./images/{frame:05d}_{camera:02d}" for frame in (3, 4, 7) for camera in (0, 1)]
    found = listed_numbers(tmp_path, names)
    assert found.numbers == (3, None, 4, None, 7, None) and "camera 0 is used" in found.notes[0]
    with pytest.raises(InputError, match="with the frame number in it, found None"):
        listed_numbers(tmp_path, ["a/1", None])
