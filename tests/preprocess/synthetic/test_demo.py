"""The generated person: performance, `.frame` invariants, determinism, and its image against its own projected mesh.

Also covers `preprocess/synthetic/animation/posing.py`, `preprocess/synthetic/studio.py`,
`preprocess/synthetic/person/character.py`, `preprocess/synthetic/person/hair.py`,
`preprocess/synthetic/person/lashes.py`, `preprocess/synthetic/person/short_hair.py`,
`preprocess/synthetic/person/skin_paint.py`, `preprocess/synthetic/person/torso.py`,
`preprocess/synthetic/rendering/hair_shading.py`.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.errors import InputError
from ggavatar.geometry.transforms import rotation_6d_to_matrix
from ggavatar.head.files import load_head
from ggavatar.head.procedural.model import procedural_names
from preprocess.cli import demo as cli
from preprocess.formats.importers.metrical_tracker import frame_dictionary
from preprocess.synthetic.animation.performance import GESTURES, VISEMES, Performance, perform
from preprocess.synthetic.demo import true_record, write_demo
from preprocess.synthetic.output_folder import prepare_demo_folder
from preprocess.synthetic.rendering import room
from preprocess.synthetic.rendering.mesh import project, rasterize
from preprocess.synthetic.settings import DemoSettings
from preprocess.synthetic.tracker_errors import add_tracker_errors

NAMES = procedural_names()[0]
SETTINGS = DemoSettings(identity=1, frames=3, size=64, noise=0.0, background="plain", seed=4)


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("demo with space")
    assert list(write_demo(folder, SETTINGS)) == [0, 1, 2]
    return folder


def digests(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.rglob("*.*"))}


def read_frame(path: Path) -> dict:
    allowed = [
        np._core.multiarray._reconstruct,
        np.ndarray,
        np.dtype,
        type(np.dtype(np.float32)),
        type(np.dtype(np.int64)),
    ]
    with torch.serialization.safe_globals(allowed):
        return torch.load(path, weights_only=True)


@pytest.fixture(scope="module")
def performance() -> Performance:
    return perform(NAMES, 600, 1)


def test_motion_covers_what_it_promises(performance):
    yaw = Rotation.from_matrix(performance.head_to_room[:, :3, :3]).as_euler("YXZ")[:, 0]
    assert np.isclose(np.rad2deg(yaw).max(), 35, atol=0.5) and np.isclose(np.rad2deg(yaw).min(), -35, atol=0.5)
    assert performance.eyelids.max() == 1.0 and (performance.eyelids[:, 0] < 0.3).mean() > 0.6
    assert performance.jaw[:, 0].max() > 0.2 and performance.jaw[:, 0].min() >= 0
    smile = performance.expression[:, NAMES.index("smile_left")]
    assert smile.max() > 0.9
    never = [name for name, most in zip(NAMES, performance.expression.max(axis=0), strict=True) if most < 0.1]
    assert never == [], "an expression that never shows cannot be learnt"


def test_motion_is_smooth_and_rigid(performance):
    rotations = performance.head_to_room[:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    step = Rotation.from_matrix(rotations[1:] @ rotations[:-1].transpose(0, 2, 1)).magnitude()
    assert np.rad2deg(step.max()) < 8
    assert np.abs(np.diff(performance.expression, axis=0)).max() < 0.9


def test_every_name_in_the_tables_is_an_expression():
    used = {name for item in (*VISEMES, *GESTURES) for name, _ in item.shapes}
    assert used <= set(NAMES)


def test_the_same_seed_gives_the_same_performance(performance):
    again = perform(NAMES, 600, 1)
    assert np.array_equal(performance.expression, again.expression)
    assert np.array_equal(performance.head_to_room, again.head_to_room)
    assert not np.array_equal(performance.expression, perform(NAMES, 600, 2).expression)


def test_frame_layout_and_invariants(demo):
    shapes = {"exp": (1, 100), "shape": (1, 300), "tex": (1, 140), "sh": (1, 9, 3)}
    shapes |= {"eyes": (1, 12), "eyelids": (1, 2), "jaw": (1, 6)}
    for index in range(3):
        frame = read_frame(demo / "tracking" / f"{index:05d}.frame")
        assert {key: value.shape for key, value in frame["flame"].items()} == shapes
        assert all(value.dtype == np.float32 for value in frame["flame"].values())
        assert frame["frame_id"] == f"{index:05d}" and frame["img_size"].tolist() == [64, 64]
        assert np.array_equal(frame["flame"]["shape"], read_frame(demo / "tracking" / "00000.frame")["flame"]["shape"])
        camera, opencv = frame["camera"], frame["opencv"]
        rotation = rotation_6d_to_matrix(torch.from_numpy(camera["R"]))[0].numpy().copy()
        rotation[:, :2] *= -1
        assert np.abs(rotation.T - opencv["R"][0]).max() < 1e-4
        assert np.abs(camera["t"][0] * (-1, -1, 1) - opencv["t"][0]).max() < 1e-6
        focal, principal = camera["fl"][0, 0] * 32, 32 - camera["pp"][0] * 32
        assert np.allclose(opencv["K"][0], [[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1]], atol=1e-3)
        assert np.isclose(np.linalg.det(opencv["R"][0]), 1, atol=1e-5)
        assert np.allclose(np.linalg.norm(frame["flame"]["eyes"].reshape(2, 2, 3), axis=2), 1, atol=1e-5)


def test_eyes_are_in_joint_order(performance):
    record = frame_dictionary(true_record(performance, 64, np.zeros(22)), 10)
    halves = torch.from_numpy(record["flame"]["eyes"].reshape(2, 6))
    expected = Rotation.from_rotvec(performance.eyes[10]).as_matrix()
    assert np.allclose(rotation_6d_to_matrix(halves).numpy(), expected, atol=1e-6)


def test_tracker_errors_are_small_and_level_zero_is_exact(performance):
    truth = true_record(performance, 512, np.zeros(22))
    assert add_tracker_errors(truth, 0.0, 3) is truth
    noisy = add_tracker_errors(truth, 1.0, 3)
    turn = noisy.world_to_camera[:, :3, :3] @ truth.world_to_camera[:, :3, :3].transpose(0, 2, 1)
    angle = np.rad2deg(Rotation.from_matrix(turn).magnitude())
    assert 0.05 < np.median(angle) < 1.5
    assert 0 < np.abs(noisy.expression - truth.expression).mean() < 0.1
    assert noisy.intrinsics[0, 0, 0] != truth.intrinsics[0, 0, 0]
    point = np.array([[0.0, 0.0, 0.05]])
    errors = [
        np.linalg.norm(project(point, noisy.intrinsics[0], b)[0, :2] - project(point, truth.intrinsics[0], a)[0, :2])
        for a, b in zip(truth.world_to_camera, noisy.world_to_camera, strict=True)
    ]
    assert 0.1 < np.median(errors) < 6


def test_demo_is_the_same_bytes_twice(demo, tmp_path):
    list(write_demo(tmp_path / "again", SETTINGS))
    assert digests(demo) == digests(tmp_path / "again")
    assert len(digests(demo)) == 3 + 3 + 5


def test_video_masks_and_truth_agree_with_the_head(demo):
    with av.open(str(demo / "video.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt, float(stream.average_rate)) == ("h264", "yuv420p", 25.0)
        assert len(list(container.decode(video=0))) == 3
    head = load_head(demo / "head.npz")
    with np.load(demo / "truth.npz", allow_pickle=False) as truth:
        assert truth["expression"].shape == (3, head.expression_basis.shape[2])
        assert truth["joint_rotations"].shape == (3, len(head.joint_names), 3)
        pose, intrinsics = truth["world_to_camera"], truth["intrinsics"]
    assert np.allclose(pose[:, 3], [0, 0, 0, 1])
    frame = read_frame(demo / "tracking" / "00002.frame")
    assert np.allclose(frame["opencv"]["R"][0], pose[2, :3, :3], atol=1e-6)
    assert np.allclose(frame["opencv"]["K"][0], intrinsics[2], atol=1e-4)


def test_projected_head_lies_in_the_matte_and_fills_the_face(demo):
    head = load_head(demo / "head.npz")
    skin = head.regions["face"].numpy()
    faces = head.faces.numpy()
    chosen = faces[np.isin(faces, skin).all(axis=1)]
    with np.load(demo / "truth.npz", allow_pickle=False) as truth:
        poses, intrinsics = truth["world_to_camera"], truth["intrinsics"]
    for index in range(3):
        matte = cv2.imread(str(demo / "masks" / f"{index:05d}.png"), cv2.IMREAD_GRAYSCALE)
        assert matte.shape == (64, 64) and matte.min() == 0 and matte.max() == 255
        assert 0.1 < (matte > 127).mean() < 0.9
        pixels = project(head.template.numpy().astype(np.float64), intrinsics[index], poses[index])
        silhouette = rasterize(pixels, chosen, 64, 64).face >= 0
        assert silhouette.sum() > 100
        assert (matte[silhouette] > 127).mean() > 0.99
        whole = rasterize(pixels, faces, 64, 64).face >= 0
        above = int(pixels[head.regions["neck"].numpy(), 1].min())
        overlap = (whole & (matte > 127))[:above].sum() / (whole | (matte > 127))[:above].sum()
        assert overlap > 0.75, "hair adds to the head, nothing else may"


def test_camera_looks_at_the_face_from_the_front():
    pixels = project(np.array([[0.0, 0.0, 0.05], [0.03, 0.03, 0.03]]), room.intrinsics(512), room.room_to_camera())
    assert np.abs(pixels[0, :2] - 256).max() < 60 and pixels[0, 2] > 0.5
    assert pixels[1, 0] > pixels[0, 0] and pixels[1, 1] < pixels[0, 1]


def test_a_folder_with_files_is_refused_and_only_own_files_are_replaced(tmp_path):
    folder = tmp_path / "used"
    (folder / "masks").mkdir(parents=True)
    (folder / "masks" / "00009.png").write_bytes(b"mine")
    (folder / "notes.txt").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="found other files"):
            prepare_demo_folder(folder, overwrite=overwrite)
    (folder / "demo.json").write_text('{"files": ["masks/00000.png", "../outside.txt"]}')
    (folder / "masks" / "00000.png").write_bytes(b"demo")
    (tmp_path / "outside.txt").write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        prepare_demo_folder(folder, overwrite=False)
    prepare_demo_folder(folder, overwrite=True)
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*"))
    assert left == ["outside.txt", "used/demo.json", "used/masks/00009.png", "used/notes.txt"]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--frames", "0"], "--frames"),
        (["--size", "63"], "--size"),
        (["--noise", "-1"], "--noise"),
        (["--seed", "-1"], "--seed"),
    ],
)
def test_bad_values_exit_2(tmp_path, capsys, flags, said):
    assert cli.main(["-o", str(tmp_path / "x"), *flags]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(("flag", "near"), [("--frame", "--frames"), ("--backgrond", "--background")])
def test_unknown_flags_exit_2_with_the_nearest(tmp_path, capsys, flag, near):
    assert cli.main(["-o", str(tmp_path / "x"), flag, "3"]) == 2
    assert near in capsys.readouterr().err


def test_identity_out_of_range_exits_2(tmp_path, capsys):
    assert cli.main(["-o", str(tmp_path / "x"), "--id", "6"]) == 2
    assert "--id 6: expected one of 1, 2, 3, 4, 5" in capsys.readouterr().err


def test_an_unfinished_demo_is_replaced_by_the_same_command(tmp_path):
    """Stopped after the second frame, then with what `kill -9` leaves; the bytes are those of one go."""
    folder = tmp_path / "demo"
    with pytest.raises(KeyboardInterrupt):
        for index in write_demo(folder, SETTINGS):
            if index == 1:
                raise KeyboardInterrupt
    assert not (folder / "video.mp4").exists(), "nothing half-written is taken for a video"
    (folder / ".video.mp4.part").write_bytes(b"half")
    (folder / "masks" / ".abc.png.part").write_bytes(b"half")
    (folder / ".lock").touch()
    prepare_demo_folder(folder, overwrite=False)
    assert {path.name for path in folder.rglob("*") if path.is_file()} == {"demo.json", ".lock"}
    list(write_demo(folder, SETTINGS))
    (folder / ".lock").unlink()
    list(write_demo(tmp_path / "whole", SETTINGS))
    assert digests(folder) == digests(tmp_path / "whole")
    with pytest.raises(InputError, match="--overwrite"):
        prepare_demo_folder(folder, overwrite=False)


def test_a_second_command_is_refused_and_a_removed_folder_does_not_come_back(tmp_path, capsys, monkeypatch):
    import shutil

    from ggavatar.io.folder_lock import lock_folder
    from preprocess.synthetic import output_folder

    folder = tmp_path / "demo"
    words = ["-o", str(folder), "--frames", "9", "--size", "32"]
    folder.mkdir()
    with lock_folder(folder):
        assert cli.main(words) == 2
    assert "is writing here" in capsys.readouterr().err and not list(folder.iterdir())
    plain = output_folder.write_png

    def removing(path, image):
        if path.name == "00008.png":
            shutil.rmtree(folder)
        plain(path, image)

    monkeypatch.setattr(output_folder, "write_png", removing)
    assert cli.main(words) == 1
    assert "removed or renamed" in capsys.readouterr().err and not folder.exists()
