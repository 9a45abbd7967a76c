"""Surface extension, gaze, torso and outline against constructions with a known answer."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
import trimesh
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head
from preprocess.tracking.face.gaze import IRIS_DEPTH_RATIO, centered_eyeballs, conjugate_gaze, eye_rotations
from preprocess.tracking.geometry.landmark_embedding import boundary_loops, closest_points, skin_faces
from preprocess.tracking.geometry.rigid import PinholeIntrinsics, RigidPoses
from preprocess.tracking.geometry.surface_extension import SurfaceExtension
from preprocess.tracking.head.personal_head import similarity_transform
from preprocess.tracking.torso.texture import TorsoTracker
from preprocess.tracking.torso.torso import (
    MAXIMUM_NECK_STRETCH,
    NeckJoints,
    TorsoImageMotions,
    neck_motion,
    torso_poses,
    track_torso,
)

INTRINSICS = PinholeIntrinsics(1000.0, (256.0, 256.0))
FACING = Rotation.from_euler("x", 180, degrees=True)


def sheet(side: int, shift: int = 0) -> np.ndarray:
    """Triangles of a square grid of vertices."""
    numbers = np.arange(side * side).reshape(side, side) + shift
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, :-1], numbers[1:, 1:]
    return np.concatenate((np.stack((a, b, c), -1).reshape(-1, 3), np.stack((b, d, c), -1).reshape(-1, 3)))


def test_extension_does_not_cross_a_gap() -> None:
    faces = np.concatenate((sheet(6), sheet(6, 36)))
    landmarks = csr_array((np.ones(4), ([0, 1, 2, 3], [7, 28, 43, 64])), shape=(4, 72))
    moved = SurfaceExtension(faces, landmarks, np.zeros(72))(np.array([[1.0], [1.0], [-2.0], [-2.0]]))
    np.testing.assert_allclose(moved[:36], 1.0, atol=1e-3)
    np.testing.assert_allclose(moved[36:], -2.0, atol=1e-3)


def test_extension_leaves_held_and_unused_vertices() -> None:
    held = np.zeros(37)
    held[30:36] = 1e4
    landmarks = csr_array((np.ones(1), ([0], [2])), shape=(1, 37))
    moved = SurfaceExtension(sheet(6), landmarks, held)(np.array([[1.0, 2.0]]))
    assert np.abs(moved[30:]).max() < 1e-3
    assert moved[2, 0] > 0.5
    np.testing.assert_allclose(moved[:, 1], 2 * moved[:, 0], atol=1e-9)


def test_closest_points_on_a_triangle() -> None:
    vertices, faces = np.eye(3), np.array([[0, 1, 2]])
    points = np.array([[1.0, 1.0, 1.0], [3.0, 0.0, 0.0], [0.9, 0.9, -2.0]])
    found, corners, weights = closest_points(points, vertices, faces)
    np.testing.assert_allclose(found, np.array([[1 / 3] * 3, [1, 0, 0], [0.5, 0.5, 0]]), atol=1e-9)
    np.testing.assert_allclose(np.einsum("nc,ncx->nx", weights, vertices[corners]), found, atol=1e-12)


def test_closest_points_of_a_head_are_the_nearest_of_all_triangles() -> None:
    """The search looks at the triangles with the nearest centers only; trimesh at every one."""
    head = procedural_head()
    vertices, faces = head.template.numpy().astype(np.float64), skin_faces(head)
    generator = np.random.default_rng(0)
    points = vertices[generator.choice(faces.ravel(), 30)] + generator.normal(0, 0.004, (30, 3))
    found, _, _ = closest_points(points, vertices, faces)
    for point, position in zip(points, found, strict=True):
        nearest = trimesh.triangles.closest_point(vertices[faces], np.tile(point, (len(faces), 1)))
        distance = np.linalg.norm(nearest - point, axis=1).min()
        assert np.linalg.norm(position - point) == pytest.approx(distance, abs=1e-9)


def test_a_sheet_has_one_border() -> None:
    (loop,) = boundary_loops(sheet(5))
    assert len(loop) == 16 and len(set(loop.tolist())) == 16


def test_similarity_is_recovered() -> None:
    generator = np.random.default_rng(0)
    source = generator.normal(size=(20, 3))
    turn = Rotation.random(random_state=1).as_matrix()
    scale, rotation, shift = similarity_transform(source, 1.7 * source @ turn.T + [1, 2, 3])
    assert scale == pytest.approx(1.7)
    np.testing.assert_allclose(rotation, turn, atol=1e-9)
    np.testing.assert_allclose(shift, [1, 2, 3], atol=1e-9)


def test_gaze_is_read_from_the_irises() -> None:
    eyes, radius = np.array([[0.031, 0.025, 0.028], [-0.031, 0.025, 0.028]]), 0.012
    poses = RigidPoses(
        (FACING * Rotation.from_euler("y", [[0], [15]], degrees=True)).as_matrix(), np.array([[0.0, 0, 0.8]] * 2)
    )
    true = np.array([[[0.1, 0.2, 0], [0.1, 0.15, 0]], [[-0.2, 0.3, 0], [-0.2, 0.25, 0]]])
    irises = np.zeros((2, 2, 2))
    for frame in range(2):
        looks = Rotation.from_rotvec(true[frame]).apply([0.0, 0.0, 1.0])
        seen = poses.to_camera((eyes + IRIS_DEPTH_RATIO * radius * looks)[None])[frame]
        irises[frame] = INTRINSICS.focal * seen[:, :2] / seen[:, 2:] + 256
    found = eye_rotations(irises, INTRINSICS, poses, eyes, radius)
    np.testing.assert_allclose(found, true, atol=0.01)


def test_eyeballs_are_moved_so_that_the_gaze_meets_the_camera() -> None:
    eyes, radius = np.array([[0.031, 0.0, 0.0], [-0.031, 0.0, 0.0]]), 0.012
    poses = RigidPoses(np.tile(FACING.as_matrix(), (5, 1, 1)), np.tile([0.0, 0.0, 0.8], (5, 1)))
    true = eyes + np.array([[0.002, 0.001, 0.0], [-0.002, 0.001, 0.0]])
    looks = np.array([0, 0, 0.8]) - true
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    seen = poses.to_camera((true + IRIS_DEPTH_RATIO * radius * looks)[None])
    irises = INTRINSICS.focal * seen[..., :2] / seen[..., 2:] + 256
    moved = centered_eyeballs(eye_rotations(irises, INTRINSICS, poses, eyes, radius), poses, eyes, radius)
    np.testing.assert_allclose(moved, true, atol=2e-4)
    turns = eye_rotations(irises, INTRINSICS, poses, moved, radius)
    np.testing.assert_allclose(turns[:, 0, 1] - turns[:, 1, 1], -0.066 / 0.8, atol=np.radians(0.5))


def test_conjugate_gaze_is_more_accurate_than_single_eyes_and_blinks_are_filled() -> None:
    time, generator = np.arange(200) / 25, np.random.default_rng(1)
    common = np.stack((0.10 * np.sin(2 * time), 0.25 * np.cos(1.5 * time), 0 * time), axis=1)
    true = common[:, None] + np.array([[0.0, -0.04, 0.0], [0.0, 0.04, 0.0]])
    noisy = true + generator.normal(0, 0.05, true.shape) * [1.0, 1.0, 0.0]
    visible = np.ones(200)
    visible[90:95] = 0
    noisy[90:95, :, 0] -= 0.6
    found = conjugate_gaze(noisy, visible, 25.0, True)
    assert np.abs(found - true).max() < 0.12 and np.sqrt(((found - true) ** 2).mean()) < 0.02
    np.testing.assert_array_equal(found[:, 0, 0], found[:, 1, 0])
    np.testing.assert_allclose(conjugate_gaze(true, visible, 25.0, False), true, atol=1e-12)


def cloth(shift: tuple[float, float]) -> np.ndarray:
    """A frame whose lower half is textured and moved by `shift` px."""
    texture = np.random.default_rng(0).integers(0, 255, (40, 40), dtype=np.uint8)
    big = cv2.resize(texture, (512, 512), interpolation=cv2.INTER_CUBIC)
    moved = cv2.warpAffine(
        big, np.array([[1.0, 0, shift[0]], [0, 1.0, shift[1]]]), (512, 512), borderMode=cv2.BORDER_REFLECT
    )
    return np.repeat(moved[..., None], 3, axis=2)


def test_torso_is_tracked_without_drift() -> None:
    tracker, mask = TorsoTracker(), np.full((512, 512), 255, np.uint8)
    chin = np.array([[200.0, 100.0], [300.0, 220.0]])
    shifts = [(0.0, 0.0), (3.0, 1.0), (7.5, -2.0), (12.0, -4.0), (0.0, 0.0)]
    assert tracker.motion(cloth(shifts[0]), mask, chin) is not None
    for shift in shifts[1:]:
        found = tracker.motion(cloth(shift), mask, chin)
        assert found is not None
        np.testing.assert_allclose(found[:2, 2] + (found[:2, :2] - np.eye(2)) @ [256, 380], shift, atol=0.6)


def test_a_torso_without_texture_is_not_tracked() -> None:
    gray, mask = np.full((256, 256, 3), 90, np.uint8), np.full((256, 256), 255, np.uint8)
    assert TorsoTracker().motion(gray, mask, np.array([[100.0, 50.0], [150.0, 110.0]])) is None


def still_head(count: int) -> tuple[HeadModel, Tracking]:
    """The procedural head, still in the upper half of the image."""
    head = procedural_head()
    views = np.tile(np.eye(4), (count, 1, 1))
    views[:, :3, :3], views[:, :3, 3] = FACING.as_matrix(), [0.0, -0.12, 0.9]
    joints = np.zeros((count, len(head.parents), 3))
    expression = np.zeros((count, head.expression_basis.shape[2]))
    intrinsics = np.tile(INTRINSICS.matrix(), (count, 1, 1))
    return head, Tracking(intrinsics, views, expression, joints, np.zeros((count, 2)), np.zeros((count, 3)))


def test_the_torso_is_tracked_beside_another_trackers_head() -> None:
    shifts = np.array([[6.0 * np.sin(0.15 * k), 3.0 * np.cos(0.1 * k)] for k in range(40)])
    head, tracking = still_head(len(shifts))
    images, masks = [cloth((x, y)) for x, y in shifts], [np.full((512, 512), 255, np.uint8)] * len(shifts)
    found = track_torso(head, tracking, images, masks, 25.0)
    assert found is not None
    moved = (found[:, :2, 3] - found[:, :2, 3].mean(axis=0)) * INTRINSICS.focal / 0.9
    np.testing.assert_allclose(moved, shifts - shifts.mean(axis=0), atol=0.5)
    np.testing.assert_allclose(np.median(found[:, :3, 3], axis=0), [0.0, -0.12, 0.9], atol=0.002)


def test_no_torso_poses_without_texture_or_where_the_tracker_rotates_the_neck() -> None:
    head, tracking = still_head(6)
    gray, masks = [np.full((512, 512, 3), 90, np.uint8)] * 6, [np.full((512, 512), 255, np.uint8)] * 6
    assert track_torso(head, tracking, gray, masks, 25.0) is None
    turned = tracking.joint_rotations.copy()
    turned[:, head.joint_index("neck"), 0] = 0.1
    textured = [cloth((0.0, 0.0))] * 6
    assert track_torso(head, dataclasses.replace(tracking, joint_rotations=turned), textured, masks, 25.0) is None
    assert track_torso(head, tracking, textured, masks, 25.0) is not None


def test_neck_motion_keeps_a_resting_torso_in_place() -> None:
    """The head nods, shifts and comes nearer; skinned by the two joints, the torso stays in place."""
    joints = NeckJoints(np.array([0.0, -0.08, -0.03]), np.array([0.0, -0.15, -0.045]))
    rest = RigidPoses(np.tile(FACING.as_matrix(), (6, 1, 1)), np.tile([0.0, 0.0, 1.0], (6, 1)))
    nod = Rotation.from_euler("x", np.linspace(-6, 6, 6)[:, None], degrees=True)
    shift = np.linspace((-0.01, 0.01, 0.0), (0.01, -0.01, 0.01), 6)
    head = RigidPoses((FACING * nod).as_matrix(), rest.translations + shift)
    neck = neck_motion(rest, head, joints)
    arm, point = joints.lower - joints.upper, np.array([0.1, -0.3, -0.02])
    stretched = neck.stretch[:, None] * arm / np.linalg.norm(arm)
    first = Rotation.from_rotvec(neck.upper)
    joint = joints.upper + first.apply(arm + stretched)
    posed = joint + (first * Rotation.from_rotvec(neck.lower)).apply(point - joints.lower)
    seen = np.einsum("tab,tb->ta", head.rotations, posed) + head.translations
    np.testing.assert_allclose(seen, np.tile(FACING.apply(point) + np.array([0, 0, 1]), (6, 1)), atol=1e-6)


def test_neck_stretch_is_limited_when_the_torso_drifts() -> None:
    joints = NeckJoints(np.array([0.0, -0.08, -0.03]), np.array([0.0, -0.15, -0.045]))
    head = RigidPoses(np.tile(FACING.as_matrix(), (3, 1, 1)), np.tile([0.0, 0.0, 1.0], (3, 1)))
    lost = RigidPoses(head.rotations, head.translations + np.array([[0, 0.0, 0], [0, 0.5, 0], [0, -0.05, 0]]))
    np.testing.assert_allclose(
        neck_motion(lost, head, joints).stretch, [0.0, MAXIMUM_NECK_STRETCH, -MAXIMUM_NECK_STRETCH], atol=1e-6
    )


def test_an_untracked_torso_rests() -> None:
    _, head = (
        np.zeros(1),
        RigidPoses(
            (FACING * Rotation.from_euler("y", np.linspace(-20, 20, 9)[:, None], degrees=True)).as_matrix(),
            np.tile([0.0, 0, 1], (9, 1)),
        ),
    )
    torso = torso_poses(TorsoImageMotions([None] * 9, [None] * 9), head, np.zeros(3), INTRINSICS, 25.0)
    np.testing.assert_allclose(torso.rotations, np.tile(FACING.as_matrix(), (9, 1, 1)), atol=1e-6)
