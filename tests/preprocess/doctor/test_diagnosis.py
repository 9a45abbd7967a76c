"""The doctor on the generated person.

Healthy as delivered, and every fault put into its tracking on purpose is named.

Also covers `preprocess/cli/terminal.py`, `preprocess/doctor/frame_offset.py`, `preprocess/doctor/preview.py`,
`preprocess/masks/pairing.py`, `preprocess/pipeline/doctor_stage.py`.
"""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.head.files import load_head
from ggavatar.io.images import image_header, write_png
from preprocess.cli.doctor import main as doctor
from preprocess.cli.prep import main as prep
from preprocess.cli.terminal import Terminal
from preprocess.doctor.convention_ranking import explained_by_frame_offset
from preprocess.doctor.conventions import AXES, FIXES, apply_fixes
from preprocess.doctor.diagnosis import examine
from preprocess.doctor.letterbox import black_bars, crop_flags
from preprocess.doctor.quality import head_positions
from preprocess.options import PrepOptions
from preprocess.synthetic.demo import write_demo
from preprocess.synthetic.settings import DemoSettings

SIZE, FRAMES = 128, 56


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A capture of the generated person."""
    place = tmp_path_factory.mktemp("subject")
    for _ in write_demo(place / "demo", DemoSettings(identity=1, frames=FRAMES, size=SIZE)):
        pass
    demo = place / "demo"
    inputs = [
        "--tracking",
        str(demo / "tracking"),
        "--masks",
        str(demo / "masks"),
        "--head-model",
        str(demo / "head.npz"),
    ]
    assert prep([str(demo / "video.mp4"), *inputs, "--size", str(SIZE), "-o", str(place / "c"), "--quiet"]) == 0
    return place / "c"


@pytest.fixture(scope="module")
def capture(folder):
    return Capture.open(folder)


@pytest.fixture(scope="module")
def head(capture):
    return load_head(capture.head_path)


def faults(capture, head, **changes):
    changed = dataclasses.replace(capture, tracking=dataclasses.replace(capture.tracking, **changes))
    return [finding for finding in examine(changed, head).findings if finding.severity == "fault"]


def test_as_delivered_it_is_healthy(capture, head):
    found = examine(capture, head)
    assert found.healthy and found.measures["silhouette_iou"] > 0.6
    assert found.measures["hypotheses"][0][0] == "as-is" and len(found.measures["hypotheses"]) == 8
    assert found.measures["eye_divergence_degrees"] < 0


# What is done to the tracking, and the finding that names it. Flips of signs are their own inverse.
WRONG = {name: name for name in [axes.name for axes in AXES[1:]]}
WRONG |= {"inverted": "inverted", "transposed": "transposed", "distance*4": "distance/4", "distance/4": "distance*4"}
WRONG |= {"swapped-eyes": "swapped-eyes"}


COMMON = {"axes+--", "axes-++", "distance*4", "swapped-eyes"}


def sorted_by_need(names, common):
    """The common mistakes always, the others only with the slow tests."""
    return [name if name in common else pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize("done", sorted_by_need(sorted(WRONG), COMMON))
def test_wrong_conventions_are_named(capture, head, done):
    wrong = FIXES[done].correct(capture.tracking, capture.width, capture.height)
    found = faults(capture, head, **wrong.arrays())
    assert [finding.code for finding in found] == [WRONG[done]]
    assert found[0].flag == f"--resume --fix {WRONG[done]}" and found[0].message
    mended = apply_fixes(wrong, [found[0].code], capture.width, capture.height)
    np.testing.assert_allclose(mended.world_to_camera, capture.tracking.world_to_camera, atol=1e-9)
    np.testing.assert_allclose(mended.joint_rotations, capture.tracking.joint_rotations)


@pytest.mark.parametrize("shift", sorted_by_need([-2, -1, 1, 2], {1}))
def test_frames_off_by_some_are_named(capture, head, shift):
    rows = np.clip(np.arange(FRAMES) + shift, 0, FRAMES - 1)
    found = faults(capture, head, **capture.tracking.rows(rows).arrays())
    assert [finding.code for finding in found] == ["offset"]
    assert found[0].flag == f"--resume --frame-offset {shift}"
    assert ("ahead" if shift > 0 else "behind") in found[0].message


def test_a_late_head_is_not_taken_for_a_turned_one(capture, head):
    """Silhouettes alone took subject 4, two frames late, for transposed (IoU 0.83 against 0.81)."""
    transposed = FIXES["transposed"]
    late = dataclasses.replace(capture, tracking=capture.tracking.rows(np.clip(np.arange(FRAMES) + 2, 0, FRAMES - 1)))
    assert explained_by_frame_offset(late, head, transposed)
    wrong = transposed.correct(capture.tracking, capture.width, capture.height)
    assert not explained_by_frame_offset(dataclasses.replace(capture, tracking=wrong), head, transposed)
    assert not explained_by_frame_offset(late, head, FIXES["centre"]), "says nothing about lenses"


@pytest.mark.parametrize("factor", sorted_by_need([2.0, 0.5, 450 / 512], {2.0}))
def test_unscaled_principal_point_is_named(capture, head, factor):
    intrinsics = capture.tracking.intrinsics.copy()
    intrinsics[:, :2, 2] *= factor
    found = faults(capture, head, intrinsics=intrinsics)
    assert [finding.code for finding in found] == ["centre"] and "principal point" in found[0].message


def test_swapped_size_of_an_oblong_capture_is_named(capture, head, tmp_path):
    """The upper three quarters of every image, with intrinsics scaled as if height were width."""
    height = 3 * SIZE // 4
    upper = dataclasses.replace(capture, folder=tmp_path / "upper", height=height, source={})
    images = ((capture.image(number)[:height], capture.mask(number)[:height]) for number in capture.frames)
    intrinsics = capture.tracking.intrinsics.copy()
    intrinsics[:, 0] *= height / SIZE
    intrinsics[:, 1] *= SIZE / height
    wrong = dataclasses.replace(upper, tracking=dataclasses.replace(capture.tracking, intrinsics=intrinsics))
    with np.load(capture.head_path) as arrays:
        wrong.write(images, {name: arrays[name] for name in arrays.files})
    found = [finding for finding in examine(wrong, head).findings if finding.severity == "fault"]
    assert found and found[0].code == "swapped-size"


@pytest.mark.parametrize(
    ("tracking", "severity", "flag"),
    [
        ({"tracker": "metrical_tracker"}, "fault", ""),
        ({"tracker": "deca", "camera_is_assumed": True}, "note", ""),
        ({"tracker": "built-in"}, "fault", "--resume --tracker.focal {}"),
    ],
)
def test_wrong_focal_length_is_named(capture, head, tracking, severity, flag):
    """Focal length and distance ×30, which hardly changes the image; only the built-in tracker takes another one."""
    intrinsics, poses = capture.tracking.intrinsics.copy(), capture.tracking.world_to_camera.copy()
    intrinsics[:, [0, 1], [0, 1]] *= 30
    poses[:, 2, 3] += 29 * head_positions(capture.tracking)[:, 2]
    wrong = dataclasses.replace(
        capture,
        tracking=dataclasses.replace(capture.tracking, intrinsics=intrinsics, world_to_camera=poses),
        source={**capture.source, "tracking": tracking},
    )
    diagnosis = examine(wrong, head)
    (found,) = [finding for finding in diagnosis.findings if finding.code == "focal"]
    magnification = capture.tracking.intrinsics[:, 0, 0] / head_positions(capture.tracking)[:, 2]
    assert (found.severity, found.flag) == (severity, flag.format(round(float(np.median(magnification)))))
    assert diagnosis.healthy == (severity == "note")


def test_another_videos_tracking_is_noticed(capture, head):
    poses = capture.tracking.world_to_camera.copy()
    poses[:, 0, 3] += 0.14
    assert "overlap" in {finding.code for finding in faults(capture, head, world_to_camera=poses)}


@pytest.mark.parametrize("side", ["left", "top", "right", "bottom"])
def test_black_bars_that_count_as_person_are_named(folder, tmp_path, side):
    shutil.copytree(folder, tmp_path / "c")
    capture = Capture.open(tmp_path / "c")
    thick, where = 9, {"left": np.s_[:, :9], "top": np.s_[:9], "right": np.s_[:, -9:], "bottom": np.s_[-9:]}[side]
    assert not any(black_bars(capture))
    for number in capture.frames:
        image, mask = capture.image(number).copy(), capture.mask(number).copy()
        image[where], mask[where] = 3, 255
        write_png(capture.image_path("images", number), image)
        write_png(capture.image_path("masks", number), mask)
    bars = black_bars(capture)
    assert bars._asdict() == {name: thick * (name == side) for name in bars._fields}
    corner = {"left": (9, 4), "top": (4, 9), "right": (0, 4), "bottom": (4, 0)}[side]
    rest = SIZE - thick
    assert crop_flags(capture, bars) == f"--resume --crop {corner[0]},{corner[1]},{rest},{rest}"


def test_our_own_tracking_is_in_our_own_convention(capture, head, monkeypatch):
    """What a head that hardly moves seems to tell of conventions counts for imported tracking only."""
    monkeypatch.setattr("preprocess.doctor.diagnosis.photometric_alternative", lambda *_: FIXES["centre"])
    assert [finding.code for finding in faults(capture, head)] == ["centre"]
    ours = dataclasses.replace(capture, source={**capture.source, "tracking": {"tracker": "built-in"}})
    assert not faults(ours, head)


def test_jitter_is_noticed(capture, head):
    poses = capture.tracking.world_to_camera.copy()
    poses[:, :2, 3] += np.random.default_rng(0).normal(0, 0.004, (FRAMES, 2))
    shaken = dataclasses.replace(capture, tracking=dataclasses.replace(capture.tracking, world_to_camera=poses))
    assert "jitter" in {finding.code for finding in examine(shaken, head).findings}


def test_report_and_preview_are_written(folder, capsys):
    report = json.loads((folder / "doctor.json").read_text())
    assert report["schema"] == "ggavatar-doctor" and report["healthy"] is True
    header = image_header(folder / "preview.jpg")
    assert (header.width, header.height) == (8 * 256, 3 * 256)
    assert doctor([str(folder), "--strict"]) == 0
    assert "doctor: healthy" in capsys.readouterr().out
    assert doctor([str(folder), "--json", "--dry-run"]) == 0
    assert json.loads(capsys.readouterr().out)["healthy"] is True


@pytest.mark.parametrize(("healthy", "start"), [(True, "next: "), (False, "not healthy: see above; to train neverth")])
def test_what_is_not_healthy_is_not_recommended_for_training(folder, capsys, healthy, start):
    report = json.loads((folder / "doctor.json").read_text()) | {"healthy": healthy}
    packed = {"frames": FRAMES, "dropped": 0, "dropped_reasons": {}}
    Terminal(quiet=False).summary(PrepOptions(folder / "video.mp4", folder), {"doctor": report, "pack": packed})
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(start) and f"ggavatar-train {folder}" in last


def test_strict_doctor_fails(folder, tmp_path, capsys):
    import shutil

    from ggavatar.io.npz import read_npz, write_npz

    wrong = tmp_path / "wrong"
    shutil.copytree(folder, wrong)
    arrays = read_npz(wrong / "tracking.npz")
    arrays["world_to_camera"][:, :3, 3] *= 4
    write_npz(wrong / "tracking.npz", arrays)
    assert doctor([str(wrong), "--strict"]) == 3
    assert "--fix distance/4" in capsys.readouterr().out
    assert doctor([str(tmp_path / "absent")]) == 2


def test_unknown_fix(capture):
    with pytest.raises(InputError, match="swapped-eyes"):
        apply_fixes(capture.tracking, ["magic"], 1, 1)
