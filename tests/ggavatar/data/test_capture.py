"""Opening and writing capture folders. Reference: docs/capture-format.md; every MUST in it is broken once.

Also covers `ggavatar/data/capture_schema.py`.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import shutil
import zipfile

import numpy as np
import pytest

from ggavatar.data.capture import Capture, Tracking
from ggavatar.data.splits import Split, split_frames
from ggavatar.errors import InputError
from ggavatar.io import atomic, images, npz
from ggavatar.io.images import image_header, read_gray, read_rgb, write_png
from ggavatar.io.npz import npz_headers, read_npz, write_npz

NUMBERS = (3, 4, 7, 9)


def head_arrays(expressions: int = 2) -> dict[str, np.ndarray]:
    return {
        "template": np.zeros((4, 3), np.float32),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "expression_basis": np.zeros((4, 3, expressions), np.float32),
        "pose_basis": np.zeros((4, 3, 0), np.float32),
        "eyelid_basis": np.zeros((4, 3, 2), np.float32),
        "joint_regressor": np.full((5, 4), 0.25, np.float32),
        "skinning_weights": np.full((4, 5), 0.2, np.float32),
        "parents": np.array([-1, 0, 1, 1, 1]),
        "joint_names": np.array(["root", "neck", "jaw", "left_eye", "right_eye"]),
        "version": np.array("test-1"),
    }


def tracking(count: int = 4) -> Tracking:
    intrinsics = np.tile(np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]]), (count, 1, 1))
    poses = np.tile(np.diag([1.0, -1, -1, 1]), (count, 1, 1))
    poses[:, 2, 3] = 1.0
    return Tracking(
        intrinsics=intrinsics,
        world_to_camera=poses,
        expression=np.zeros((count, 2)),
        joint_rotations=np.zeros((count, 5, 3)),
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
    )


def a_capture(folder, **changes) -> Capture:
    capture = Capture(
        folder=folder,
        subject="someone",
        width=16,
        height=12,
        fps=25.0,
        frames=NUMBERS,
        splits={"every-20th": split_frames(NUMBERS, "every-20th")},
        tracking=tracking(),
        head_version="test-1",
        source={"name": "video.mp4"},
        dropped=({"frame": 5, "reason": "no mask"},),
    )
    return dataclasses.replace(capture, **changes)


def images_of(numbers):
    for number in numbers:
        image = np.full((12, 16, 3), number * 10, np.uint8)
        image[0, 0] = [255, 128, 7]
        yield image, np.full((12, 16), number * 20, np.uint8)


@pytest.fixture
def folder(tmp_path):
    target = tmp_path / "cap"
    a_capture(target).write(images_of(NUMBERS), head_arrays())
    return target


def test_round_trip(folder):
    capture = Capture.open(folder)
    assert (capture.subject, capture.width, capture.height, capture.fps, capture.frames) == (
        "someone",
        16,
        12,
        25.0,
        NUMBERS,
    )
    assert capture.splits["every-20th"] == Split((4, 7, 9), (3,))
    assert capture.image(7).shape == (12, 16, 3) and capture.image(7)[0, 0].tolist() == [255, 128, 7]
    assert capture.mask(9)[5, 5] == 180 and capture.row(9) == 3
    assert capture.dropped[0]["frame"] == 5 and capture.source["name"] == "video.mp4"
    np.testing.assert_array_equal(capture.tracking.intrinsics, tracking().intrinsics)


def test_digest_follows_content_only(folder, tmp_path):
    first = Capture.open(folder).digest()
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder, moved)
    (moved / "preview.jpg").write_bytes(b"anything")
    assert Capture.open(moved).digest() == first
    write_png(moved / "masks" / "000004.png", np.zeros((12, 16), np.uint8))
    assert Capture.open(moved).digest() != first


def test_unknown_frame_and_split(folder):
    capture = Capture.open(folder)
    with pytest.raises(InputError, match="no frame 5"):
        capture.image(5)
    with pytest.raises(InputError, match="every-20th"):
        capture.split("last-350")


def edit(folder, **changes):
    path = folder / "capture.json"
    data = json.loads(path.read_text())
    data.update(changes)
    path.write_text(json.dumps({key: value for key, value in data.items() if value is not ...}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": "nerf"}, "schema"),
        ({"version": 2}, "version 2 is unknown"),
        ({"version": ...}, "version None is unknown"),
        ({"subject": ""}, "subject"),
        ({"width": 17}, "expected 17×12"),
        ({"width": True}, "width"),
        ({"height": -1}, "height"),
        ({"height": 10**9}, "height"),
        ({"fps": 0}, "fps"),
        ({"frames": []}, "frames"),
        ({"frames": [3, 4, 4, 9]}, "ascending"),
        ({"frames": [3, 4, 7], "splits": {"every-20th": {"train": [3], "test": [4]}}}, "expected 3 rows"),
        ({"frames": [3, 4, 7, 8]}, "000008.png|frames of the capture"),
        ({"frames": [-1, 4, 7, 9]}, "ascending whole"),
        ({"splits": {}}, "every-20th"),
        ({"splits": {"every-20th": {"train": [3, 4], "test": [4]}}}, "share no frame"),
        ({"splits": {"every-20th": {"train": [3, 5], "test": [4]}}}, r"frames of the capture, found \[5\]"),
        ({"splits": {"every-20th": {"train": [3, "4"], "test": [7]}}}, "whole numbers"),
        ({"splits": {"every-20th": [1]}}, "train"),
        ({"head": {"version": "flame2020"}}, "version is 'test-1'"),
        ({"head": None}, "head"),
        ({"source": [1]}, "source"),
        ({"dropped": [1]}, "dropped"),
    ],
)
def test_wrong_description(folder, changes, message):
    edit(folder, **changes)
    with pytest.raises(InputError, match=message) as caught:
        Capture.open(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intrinsics": np.zeros((4, 3, 3))}, "positive focal"),
        ({"intrinsics": np.tile(np.eye(4), (4, 1, 1))}, "expected 'intrinsics' of shape"),
        ({"world_to_camera": np.tile(np.diag([2.0, 2, 2, 1]), (4, 1, 1))}, "scales or shears"),
        ({"world_to_camera": np.tile(np.diag([-1.0, 1, 1, 1]), (4, 1, 1))}, "mirrored"),
        ({"world_to_camera": np.tile(np.diag([1.0, 1, 1, 2]), (4, 1, 1))}, "last row"),
        ({"torso_to_camera": np.tile(np.diag([2.0, 2, 2, 1]), (4, 1, 1))}, "'torso_to_camera' row 0"),
        ({"torso_to_camera": np.tile(np.eye(4), (3, 1, 1))}, "expected 'torso_to_camera' of shape"),
        ({"expression": np.full((4, 2), np.nan)}, "'expression' holds NaN or infinity, first in row 0"),
        ({"expression": np.zeros((4, 3))}, "2 expression coefficients, tracking.npz has 3"),
        ({"expression": np.zeros((3, 2))}, "expected 'expression' of shape"),
        ({"joint_rotations": np.zeros((4, 6, 3))}, "5 joints"),
        ({"translation": np.zeros((4, 3), int)}, "floating point"),
        ({"eyelids": ...}, "no array 'eyelids'"),
        ({"shape": np.array([np.inf])}, "'shape'"),
        ({"landmarks": np.zeros((4, 5))}, "landmarks"),
    ],
)
def test_wrong_tracking(folder, changes, message):
    stored = {**read_npz(folder / "tracking.npz"), **changes}
    write_npz(folder / "tracking.npz", {key: value for key, value in stored.items() if value is not ...})
    with pytest.raises(InputError, match=message) as caught:
        Capture.open(folder)
    assert ".npz" in str(caught.value)


def test_landmarks_may_have_gaps(folder):
    stored = read_npz(folder / "tracking.npz") | {"landmarks": np.full((4, 5, 2), np.nan)}
    write_npz(folder / "tracking.npz", stored)
    assert np.isnan(Capture.open(folder).tracking.landmarks).all()


@pytest.mark.parametrize("name", sorted(head_arrays()))
def test_missing_head_array(folder, name):
    write_npz(folder / "head.npz", {key: value for key, value in head_arrays().items() if key != name})
    with pytest.raises(InputError, match=f"no array '{name}'"):
        Capture.open(folder)


@pytest.mark.parametrize("kind", ["images", "masks"])
def test_wrong_images(folder, kind):
    path = folder / kind / "000007.png"
    original = path.read_bytes()
    path.unlink()
    with pytest.raises(InputError, match=r"000007\.png: no such file"):
        Capture.open(folder)
    write_png(path, np.zeros((12, 15, 3), np.uint8))
    with pytest.raises(InputError, match=r"expected 16×12 px as capture\.json says, found 15×12"):
        Capture.open(folder)
    path.write_bytes(original[:20])
    with pytest.raises(InputError, match="truncated"):
        Capture.open(folder)
    path.write_bytes(b"GIF89a" + original)
    with pytest.raises(InputError, match="expected a PNG or JPEG"):
        Capture.open(folder)
    path.write_bytes(original[: len(original) // 2])
    with pytest.raises(InputError, match="damaged"):
        getattr(Capture.open(folder), kind[:-1])(7)


@pytest.mark.parametrize("name", ["capture.json", "tracking.npz", "head.npz"])
def test_missing_file(folder, name):
    (folder / name).unlink()
    with pytest.raises(InputError, match=name):
        Capture.open(folder)


@pytest.mark.parametrize("made", [True, False])
@pytest.mark.parametrize("damaged", ["tracking.npz", "images/000007.png", "masks/000007.png"])
def test_damage_in_a_capture_of_our_making_says_how_to_mend_it(folder, damaged, made):
    whole = (folder / damaged).read_bytes()
    (folder / damaged).write_bytes(whole[: len(whole) - 20])
    if made:
        (folder / ".prep").mkdir()
    with pytest.raises(InputError, match=damaged) as caught:
        capture = Capture.open(folder)
        capture.image(7), capture.mask(7)
    assert ("--overwrite" in str(caught.value)) == made


def test_unfinished_capture_says_resume(folder):
    (folder / ".prep").mkdir()
    (folder / "capture.json").unlink()
    with pytest.raises(InputError, match="--resume"):
        Capture.open(folder)


def test_no_folder_at_all(tmp_path):
    with pytest.raises(InputError, match="ggavatar-prep"):
        Capture.open(tmp_path / "absent")


def test_writing_never_touches_an_existing_folder(folder):
    before = sorted(path.name for path in folder.rglob("*"))
    with pytest.raises(InputError, match="already exists"):
        a_capture(folder).write(images_of(NUMBERS), head_arrays())
    assert sorted(path.name for path in folder.rglob("*")) == before


def test_full_disk_leaves_nothing(tmp_path, monkeypatch):
    """The disk fills up at every possible write in turn; no folder, no temporary file may remain."""
    calls = 0

    def failing(stop):
        original = atomic.os.replace
        state = {"left": stop}

        def replace(source, target):
            state["left"] -= 1
            if state["left"] < 0:
                raise OSError(errno.ENOSPC, "No space left on device", str(target))
            original(source, target)

        return replace

    for stop in range(11):
        with monkeypatch.context() as patch:
            patch.setattr(atomic.os, "replace", failing(stop))
            with pytest.raises(OSError, match="No space left"):
                a_capture(tmp_path / "cap").write(images_of(NUMBERS), head_arrays())
        assert list(tmp_path.iterdir()) == []
        calls += 1
    assert calls == 11


def test_interrupted_write_keeps_the_old_file(folder, monkeypatch):
    before = (folder / "tracking.npz").read_bytes()
    monkeypatch.setattr(atomic.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.ENOSPC, "full")))
    with pytest.raises(OSError, match="full"):
        write_npz(folder / "tracking.npz", {"x": np.zeros(3)})
    assert (folder / "tracking.npz").read_bytes() == before
    assert not [path for path in folder.iterdir() if path.suffix == ".part"]


def test_npz_is_numpys_own_format(tmp_path):
    """Reference: numpy.savez and numpy.load."""
    values = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.array([1, 2], np.uint8)}
    write_npz(tmp_path / "ours.npz", values)
    with np.load(tmp_path / "ours.npz") as found:
        for name, value in values.items():
            np.testing.assert_array_equal(found[name], value)
    np.savez_compressed(tmp_path / "theirs.npz", **values)
    for name, value in read_npz(tmp_path / "theirs.npz").items():
        np.testing.assert_array_equal(value, values[name])
    assert npz_headers(tmp_path / "theirs.npz")["a"].shape == (2, 3)
    write_npz(tmp_path / "again.npz", values)
    assert (tmp_path / "ours.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()


def test_npz_refuses_objects_bombs_and_lies(tmp_path, monkeypatch):
    path = tmp_path / "x.npz"
    np.savez(path, a=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="Python objects"):
        read_npz(path)
    monkeypatch.setattr(npz, "MAX_ARCHIVE_BYTES", 1 << 20)
    np.savez_compressed(path, a=np.zeros(1 << 18))
    assert path.stat().st_size < 10_000
    with pytest.raises(InputError, match="unpacks to 2 MiB"):
        read_npz(path)
    header = (
        b"\x93NUMPY\x01\x00\x76\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000,), }".ljust(117)
        + b"\n"
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", header + b"12345678")
    with pytest.raises(InputError, match="claims shape"):
        read_npz(path)
    path.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="expected an npz"):
        npz_headers(path)


def test_huge_images_are_refused_before_decoding(tmp_path):
    path = tmp_path / "huge.png"
    write_png(path, np.zeros((4, 4), np.uint8))
    data = bytearray(path.read_bytes())
    data[16:24] = (1 << 16).to_bytes(4, "big") * 2
    path.write_bytes(data)
    with pytest.raises(InputError, match="65536×65536"):
        read_gray(path)


def test_images_of_other_kinds(tmp_path):
    """16-bit, with transparency, gray, JPEG; reference: the values written by OpenCV."""
    import cv2

    deep = np.full((4, 6), 65535 // 2, np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    assert abs(int(read_gray(tmp_path / "deep.png")[0, 0]) - 127) <= 1
    cut = np.zeros((4, 6, 4), np.uint8)
    cut[..., 3] = 77
    cv2.imwrite(str(tmp_path / "cut.png"), cut)
    assert (read_gray(tmp_path / "cut.png") == 77).all() and read_rgb(tmp_path / "cut.png").shape == (4, 6, 3)
    images.write_jpeg(tmp_path / "p.jpg", np.full((10, 20, 3), 90, np.uint8))
    assert image_header(tmp_path / "p.jpg")[:2] == (20, 10)
    assert abs(int(read_rgb(tmp_path / "p.jpg")[5, 5, 0]) - 90) <= 2
