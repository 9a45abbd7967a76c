"""Transfer, limits, smoothing and neutral frames, against closed forms and scipy's rotations."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from evaluate.figures.reenactment import reenactment, representative_rows
from evaluate.motion.driving_sequence import driving_sequence_of, read_driving_sequence
from evaluate.motion.retarget import basis_family, match_basis
from evaluate.motion.smoothing import one_euro, savgol, smoothed
from evaluate.motion.transfer import (
    TransferOptions,
    limit_to_training_range,
    soft_clip,
    transfer_performance,
)
from ggavatar.errors import InputError
from tests.support.performances import motion
from tests.support.toy_run import COUNT, JOINTS, write_capture

RAW = TransferOptions("relative", smooth="none", margin=None)


def test_relative_transfer_adds_changes_to_the_targets_neutral() -> None:
    driver, target = motion(1), motion(2)
    moved = transfer_performance(driver, 3, target, 7, RAW)
    np.testing.assert_allclose(moved.expression - target.expression[7], driver.expression - driver.expression[3])
    np.testing.assert_allclose(
        moved.translation[4] - moved.translation[3], driver.translation[4] - driver.translation[3]
    )
    np.testing.assert_allclose(moved.joint_rotations[3], target.joint_rotations[7], atol=1e-12)
    turn = Rotation.from_rotvec(moved.joint_rotations[9, 2]) * Rotation.from_rotvec(target.joint_rotations[7, 2]).inv()
    expected = (
        Rotation.from_rotvec(driver.joint_rotations[9, 2]) * Rotation.from_rotvec(driver.joint_rotations[3, 2]).inv()
    )
    np.testing.assert_allclose(turn.as_matrix(), expected.as_matrix(), atol=1e-12)


def test_transfer_to_oneself_changes_nothing() -> None:
    driver = motion(1)
    moved = transfer_performance(driver, 3, driver, 3, RAW)
    np.testing.assert_allclose(moved.expression, driver.expression)
    np.testing.assert_allclose(moved.joint_rotations, driver.joint_rotations, atol=1e-12)
    assert moved.cameras and driver.cameras
    np.testing.assert_allclose(moved.cameras.world_to_camera, driver.cameras.world_to_camera, atol=1e-12)


def test_pose_moves_by_the_same_part_of_the_image() -> None:
    driver, target = motion(1, depth=1.0), motion(2, depth=3.0, width=400)
    moved = transfer_performance(driver, 0, target, 0, RAW)
    assert moved.cameras and target.cameras and driver.cameras
    factor = target.cameras.view_width() / driver.cameras.view_width()
    np.testing.assert_allclose(
        factor, target.cameras.world_to_camera[0, 2, 3] / driver.cameras.world_to_camera[0, 2, 3] * 4
    )
    change = moved.cameras.world_to_camera[5, :3, 3] - target.cameras.world_to_camera[0, :3, 3]
    expected = driver.cameras.world_to_camera[5, :3, 3] - driver.cameras.world_to_camera[0, :3, 3]
    np.testing.assert_allclose(change, expected * factor)
    rotation = moved.cameras.world_to_camera[:, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), np.repeat(np.eye(3)[None], 12, 0), atol=1e-12)


def test_still_and_absolute_pose_and_drivers_without_cameras() -> None:
    driver, target = motion(1), motion(2)
    assert driver.cameras and target.cameras
    still = transfer_performance(driver, 0, target, 4, dataclasses.replace(RAW, pose="still"))
    copied = transfer_performance(
        driver, 0, target, 4, dataclasses.replace(RAW, expression="absolute", pose="absolute")
    )
    blind = transfer_performance(dataclasses.replace(driver, cameras=None), 0, target, 4, RAW)
    for moved in (still, blind):
        assert moved.cameras and len(moved.cameras.world_to_camera) == len(moved.frames)
        np.testing.assert_array_equal(moved.cameras.world_to_camera[8], target.cameras.world_to_camera[4])
    assert copied.cameras
    np.testing.assert_array_equal(copied.cameras.world_to_camera, driver.cameras.world_to_camera)
    np.testing.assert_array_equal(copied.expression, driver.expression)


@settings(deadline=None, max_examples=50)
@given(st.floats(-20, 20), st.floats(0.01, 1.0))
def test_soft_clip_is_the_identity_inside_and_bounded_outside(value: float, margin: float) -> None:
    seen = np.array([[-1.0], [2.0]])
    kept = float(soft_clip(np.array([[value]]), seen, margin)[0, 0])
    if -1 <= value <= 2:
        assert kept == value
    assert -1 - 3 * margin - 1e-6 <= kept <= 2 + 3 * margin + 1e-6
    further = float(soft_clip(np.array([[value + 0.5]]), seen, margin)[0, 0])
    assert further >= kept, "order is kept"


def test_limits_hold_expressions_and_joint_angles() -> None:
    seen, wild = motion(1), motion(2)
    wild = dataclasses.replace(wild, expression=wild.expression * 50, joint_rotations=wild.joint_rotations * 6)
    kept = limit_to_training_range(wild, seen, 0, 0.1)
    widths = seen.expression.max(0) - seen.expression.min(0)
    zone = 0.1 * np.maximum(widths, np.median(widths)) + 1e-6
    assert (kept.expression <= seen.expression.max(0) + zone).all() and (
        kept.expression >= seen.expression.min(0) - zone
    ).all()
    rest = Rotation.from_rotvec(seen.joint_rotations[0, 1]).inv()
    most = (Rotation.from_rotvec(seen.joint_rotations[:, 1]) * rest).magnitude().max()
    assert (Rotation.from_rotvec(kept.joint_rotations[:, 1]) * rest).magnitude().max() <= most * 1.1 + 1e-6
    same = limit_to_training_range(seen, seen, 0, 0.1)
    np.testing.assert_allclose(same.expression, seen.expression)
    np.testing.assert_allclose(same.joint_rotations, seen.joint_rotations, atol=1e-9)


def test_savgol_keeps_parabolas_and_removes_noise() -> None:
    time = np.linspace(-1, 1, 60)[:, None]
    parabola = 3 * time**2 - time + 0.5
    np.testing.assert_allclose(savgol(parabola), parabola, atol=1e-12)
    noisy = parabola + np.random.default_rng(0).normal(0, 0.1, parabola.shape)
    assert np.abs(savgol(noisy) - parabola).mean() < 0.8 * np.abs(noisy - parabola).mean()
    assert savgol(parabola[:2]).tolist() == parabola[:2].tolist() and savgol(parabola[:4]).shape == (4, 1)


def test_one_euro_is_steady_at_rest_and_follows_motion() -> None:
    random = np.random.default_rng(0)
    still = random.normal(0, 1, (200, 1))
    assert one_euro(still, 25.0, beta=0.0)[50:].std() < 0.6 * still[50:].std()
    ramp = np.linspace(0, 10, 200)[:, None]
    slow, quick = one_euro(ramp, 25.0, beta=0.0), one_euro(ramp, 25.0, beta=20.0)
    assert abs(quick[-1, 0] - 10) < 0.3 * abs(slow[-1, 0] - 10), "a higher beta lags less"
    np.testing.assert_allclose(one_euro(np.full((10, 2), 3.0), 25.0), 3.0)
    with pytest.raises(ValueError, match="savgol"):
        smoothed(still, "median", 25.0)


def test_smoothing_keeps_a_performance_at_rest() -> None:
    driver = motion(1)
    resting = driver.rows(np.zeros(12, int))
    moved = transfer_performance(
        dataclasses.replace(resting, frames=driver.frames), 0, driver, 0, TransferOptions("relative", margin=None)
    )
    np.testing.assert_allclose(moved.joint_rotations, resting.joint_rotations, atol=1e-9)


def test_another_basis_is_refused_and_its_family_filled_up_by_force() -> None:
    target = motion(2)
    shorter = dataclasses.replace(motion(1), expression=np.ones((12, 2)))
    with pytest.raises(InputError, match="--force-basis"):
        match_basis(shorter, target)
    filled = match_basis(shorter, target, force=True)
    assert filled.expression[0].tolist() == [1, 1, 0, 0] and filled.head_version == "toy-1"
    newer = dataclasses.replace(motion(1), head_version="toy-2")
    with pytest.raises(InputError, match="'toy-2'"):
        match_basis(newer, target)
    assert match_basis(newer, target, force=True).expression.shape == (12, 4)
    for force in (False, True):
        with pytest.raises(InputError, match="mean different things"):
            match_basis(dataclasses.replace(motion(1), head_version="pca-of-bob"), target, force)
    assert {basis_family(tag) for tag in ("flame2020", "FLAME2023", "flame-2023.1")} == {"flame"}


def test_joints_are_matched_by_name() -> None:
    target, driver = motion(2), motion(1)
    turned = dataclasses.replace(driver, joint_names=("jaw", "root"), joint_rotations=driver.joint_rotations[:, :2])
    fitted = match_basis(turned, target)
    np.testing.assert_array_equal(fitted.joint_rotations[:, 2], driver.joint_rotations[:, 0])
    np.testing.assert_array_equal(fitted.joint_rotations[:, 0], driver.joint_rotations[:, 1])
    assert not fitted.joint_rotations[:, [1, 3, 4]].any()


def test_capture_and_npz_give_the_same_motion(tmp_path: Path) -> None:
    capture = write_capture(tmp_path / "capture")
    whole = driving_sequence_of(capture)
    tracked = {name: value for name, value in capture.tracking.arrays().items()}
    np.savez(
        tmp_path / "params.npz", version="toy-1", joint_names=np.array(JOINTS), fps=25.0, frames=capture.frames,
        size=[capture.width, capture.height], **tracked,
    )  # fmt: skip
    read = read_driving_sequence(tmp_path / "params.npz")
    for name in ("expression", "joint_rotations", "eyelids", "translation"):
        np.testing.assert_array_equal(getattr(read, name), getattr(whole, name))
    assert (read.frames, read.joint_names, read.head_version) == (whole.frames, whole.joint_names, whole.head_version)
    assert read.cameras and whole.cameras and read.cameras.size == whole.cameras.size
    assert len(read_driving_sequence(tmp_path / "capture").frames) == COUNT and read.row(12) == 2


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"version": "toy-1"}, "array 'expression'"),
        ({"expression": np.zeros((3, 4))}, "'version'"),
        ({"expression": np.zeros((0, 4)), "version": "toy-1"}, "of shape any×any"),
        ({"expression": np.full((3, 4), np.nan), "version": "toy-1"}, "finite numbers"),
        ({"expression": np.zeros((3, 4)), "eyelids": np.zeros((2, 2)), "version": "toy-1"}, "of shape 3×2, found 2×2"),
        ({"expression": np.zeros((3, 4)), "joint_rotations": np.zeros((3, 5, 3)), "version": "x"}, "'joint_names'"),
        ({"expression": np.zeros((3, 4)), "world_to_camera": np.zeros((3, 4, 4)), "version": "x"}, "size together"),
        ({"expression": np.zeros((3, 4)), "frames": [1, 1, 2], "version": "x"}, "ascending"),
        ({"expression": np.zeros((3, 4)), "fps": 0.0, "version": "x"}, "frames per second"),
    ],
)
def test_bad_parameter_files_are_refused(tmp_path: Path, arrays: dict, words: str) -> None:
    np.savez(tmp_path / "params.npz", **arrays)
    with pytest.raises(InputError, match=words):
        read_driving_sequence(tmp_path / "params.npz")


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "params.pkl").write_bytes(b"x")
    with pytest.raises(InputError, match=r"capture folder, an \.npz file"):
        read_driving_sequence(tmp_path / "params.pkl")


def test_figure_picks_frames_that_differ(tmp_path: Path) -> None:
    calm = motion(1, count=20)
    calm = dataclasses.replace(
        calm, expression=np.zeros((20, 4)), joint_rotations=np.zeros((20, 5, 3)), eyelids=np.zeros((20, 2))
    )
    calm.expression[4, 0], calm.expression[15, 1] = 3.0, 3.0
    assert {4, 15} <= set(representative_rows(calm, 3)) and len(representative_rows(calm, 50)) == 20
    tiles = [np.full((20, 20, 3), 40 * k, np.uint8) for k in range(3)]
    both = reenactment(tiles, {"ours": tiles, "theirs": tiles}, ["1", "2", "3"], width=64)
    assert reenactment([], {"ours": tiles}, width=64).shape[0] < both.shape[0]
