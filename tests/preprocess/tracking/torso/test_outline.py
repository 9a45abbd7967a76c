"""Motion of the shoulders from a drawn outline with known motion, with and without texture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from preprocess.tracking.geometry.rigid import PinholeIntrinsics, RigidPoses
from preprocess.tracking.pose.outline_cue import OutlineDistances, signed_distances
from preprocess.tracking.torso.outline import outline_motions
from preprocess.tracking.torso.torso import (
    CHEST_DEPTH,
    MAXIMUM_TORSO_ROTATION,
    TorsoImageMotions,
    torso_image_motions,
    torso_poses,
)

SIZE, FPS, FRAMES = 512, 25.0, 60
FACES = np.tile([120.0, 330.0], (FRAMES, 1))
BODY = np.array(
    [
        [-60, 512],
        [-20, 430],
        [60, 395],
        [150, 375],
        [205, 335],
        [307, 335],
        [362, 375],
        [452, 395],
        [532, 430],
        [572, 512],
    ]
)
MIDDLE = np.array([256.0, 400.0])
INTRINSICS = PinholeIntrinsics(1200.0, (256.0, 256.0))


def similarity(shift: tuple[float, float], roll: float = 0.0, size: float = 1.0) -> np.ndarray:
    """Roll and scale about the center of the shoulders, then a shift."""
    turn = size * np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    return np.block([[turn, (MIDDLE - turn @ MIDDLE + shift)[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])


def truth() -> np.ndarray:
    """A torso that shrugs, sways and rolls, within two seconds."""
    time = np.arange(FRAMES) / FPS
    ways = zip(5 * np.sin(3 * time), 6 * np.cos(4 * time), 0.03 * np.sin(2 * time), strict=True)
    return np.stack([similarity((x, y), roll) for x, y, roll in ways])


def drawn(motions: np.ndarray) -> OutlineDistances:
    """Outlines of a resting head and a moving body."""
    distances = []
    for motion in motions:
        mask = np.zeros((SIZE, SIZE), np.uint8)
        body = BODY @ motion[:2, :2].T + motion[:2, 2]
        cv2.fillPoly(mask, [np.round(body * 16).astype(np.int32)], 255, shift=4)
        cv2.ellipse(mask, (256, 220), (75, 110), 0, 0, 360, 255, -1)
        distances.append(signed_distances(mask))
    return OutlineDistances(np.stack(distances), 128 / SIZE)


def shoulder_errors(found: list[np.ndarray | None], motions: np.ndarray) -> np.ndarray:
    """Errors of both shoulders without their constant part, px."""
    shoulders = np.array([[110.0, 385.0, 1.0], [402.0, 385.0, 1.0]]).T
    apart = np.stack([here @ shoulders - motion @ shoulders for here, motion in zip(found, motions, strict=True)])[
        :, :2
    ]
    return apart - np.median(apart, axis=0)


def test_shoulders_without_texture_are_tracked_by_their_outline() -> None:
    motions = truth()
    found = outline_motions([None] * FRAMES, drawn(motions), FACES, FPS)
    error = shoulder_errors(found, motions)
    assert np.sqrt((error[:, 1] ** 2).mean()) < 0.3
    assert np.sqrt((error[:, 0] ** 2).mean()) < 0.5
    resting = shoulder_errors([np.eye(3)] * FRAMES, motions)
    assert np.sqrt((resting[:, 1] ** 2).mean()) > 5


def test_drift_of_the_texture_is_corrected() -> None:
    motions = truth()
    drifting = [similarity((0.02 * k, 0.15 * k)) @ motion for k, motion in enumerate(motions)]
    error = shoulder_errors(outline_motions(drifting, drawn(motions), FACES, FPS), motions)
    assert np.abs(shoulder_errors(drifting, motions)).max() > 4
    assert np.sqrt((error**2).mean()) < 0.4


def test_texture_decides_what_the_outline_does_not_constrain() -> None:
    """A straight edge across the whole image does not constrain a shift along it."""
    motions = np.stack([similarity((4 * np.sin(0.1 * k), 3 * np.cos(0.1 * k))) for k in range(FRAMES)])
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[400:] = 255
    moved = [np.roll(mask, round(motion[1, 2]), axis=0) for motion in motions]
    outline = OutlineDistances(np.stack([signed_distances(here) for here in moved]), 128 / SIZE)
    error = shoulder_errors(outline_motions(list(motions), outline, FACES, FPS), motions)
    assert np.abs(error[:, 0]).max() < 0.3


def test_without_an_outline_below_the_chin_texture_is_returned_unchanged() -> None:
    motions = list(truth())
    nothing = OutlineDistances(np.full((FRAMES, 128, 128), 127, np.int8), 128 / SIZE)
    found = outline_motions([None, *motions[1:]], nothing, FACES, FPS)
    assert found[0] is None and all(a is b for a, b in zip(found[1:], motions[1:], strict=True))


@pytest.mark.parametrize(("axis", "angle"), [(0, 0.05), (1, -0.08)])
def test_a_chest_that_moves_against_the_shoulders_is_a_rotation(axis: int, angle: float) -> None:
    """Head at rest, 1 m away: the chest in front of the shoulders moves with the rotation, the outline does not."""
    facing = np.tile(np.diag([1.0, -1.0, -1.0]), (FRAMES, 1, 1))
    head, pivot = RigidPoses(facing, np.tile([0.0, 0.0, 1.0], (FRAMES, 1))), np.array([0.0, -0.15, 0.0])
    angles = angle * np.sin(np.arange(FRAMES) / FRAMES * 2 * np.pi)
    moves = np.zeros((FRAMES, 2))
    moves[:, 1 - axis] = (angles if axis == 0 else -angles) * CHEST_DEPTH * INTRINSICS.focal
    texture = [similarity((float(x), float(y))) for x, y in moves]
    found = torso_poses(TorsoImageMotions(texture, [np.eye(3)] * FRAMES), head, pivot, INTRINSICS, FPS)
    turns = found.rotations @ facing.transpose(0, 2, 1)
    angles_found = np.stack((turns[:, 2, 1], turns[:, 0, 2]))[axis]
    np.testing.assert_allclose(angles_found - np.median(angles_found), angles - np.median(angles), atol=5e-3)
    seen = found.to_camera(pivot[None, None])[:, 0]
    np.testing.assert_allclose(seen, np.tile([0, 0.15, 1], (FRAMES, 1)), atol=1e-6)


def test_rotation_is_limited_when_tracking_of_the_chest_fails() -> None:
    facing = np.tile(np.diag([1.0, -1.0, -1.0]), (9, 1, 1))
    head = RigidPoses(facing, np.tile([0.0, 0.0, 1.0], (9, 1)))
    lost = [similarity((200.0 * (k > 6), 0.0)) for k in range(9)]
    found = torso_poses(TorsoImageMotions(lost, [np.eye(3)] * 9), head, np.array([0.0, -0.15, 0.0]), INTRINSICS, FPS)
    angles = np.arccos((np.trace(found.rotations @ facing.transpose(0, 2, 1), axis1=1, axis2=2) - 1) / 2)
    assert angles.max() <= 1.3 * MAXIMUM_TORSO_ROTATION


def test_frames_without_texture_do_not_rotate_the_torso() -> None:
    """A constant offset of 10 px where the chest was tracked is no rotation, neither there nor elsewhere."""
    facing = np.tile(np.diag([1.0, -1.0, -1.0]), (9, 1, 1))
    head = RigidPoses(facing, np.tile([0.0, 0.0, 1.0], (9, 1)))
    texture = [None if k < 4 else similarity((10.0, 5.0)) for k in range(9)]
    found = torso_poses(TorsoImageMotions(texture, [np.eye(3)] * 9), head, np.array([0.0, -0.15, 0.0]), INTRINSICS, FPS)
    np.testing.assert_allclose(found.rotations, facing, atol=1e-9)


def test_texture_alone_is_used_for_both_where_there_is_no_outline() -> None:
    motions = list(truth())
    nothing = OutlineDistances(np.full((FRAMES, 128, 128), 127, np.int8), 128 / SIZE)
    both = torso_image_motions(motions, nothing, [(120.0, 330.0)] * FRAMES, FPS)
    assert both.reliable and all(a is b for a, b in zip(both.outline, motions, strict=True))
