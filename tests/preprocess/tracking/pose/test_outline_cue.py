"""Poses fused from landmarks and outline, against a synthetic head with known poses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from preprocess.tracking.geometry.rigid import LandmarkObservations, PinholeIntrinsics, RigidPoses, project_to_pixels
from preprocess.tracking.pose.fusion import LandmarkCue, effective_observations, fuse_poses
from preprocess.tracking.pose.outline_cue import (
    DIRECTIONS,
    OutlineCue,
    OutlineDistances,
    ScalpSurface,
    outline_vertices,
    sample_distances,
    signed_distances,
)

SIZE = 512
INTRINSICS = PinholeIntrinsics(1000.0, (256.0, 256.0))
MIDDLE, RADII = np.array([0.0, 0.05, -0.02]), np.array([0.075, 0.100, 0.095])
FRAMES = 12


def ellipsoid() -> ScalpSurface:
    """The upper part of an ellipsoid."""
    number = np.arange(4000)
    height, turn = 1 - 2 * (number + 0.5) / len(number), np.pi * (1 + 5**0.5) * number
    unit = np.stack((np.sqrt(1 - height**2) * np.cos(turn), height, np.sqrt(1 - height**2) * np.sin(turn)), axis=1)
    normals = unit / RADII
    upper = unit[:, 1] > -0.2
    return ScalpSurface((MIDDLE + RADII * unit)[upper], (normals / np.linalg.norm(normals, axis=1)[:, None])[upper])


SCALP = ellipsoid()


def true_poses() -> RigidPoses:
    facing = Rotation.from_euler("x", 180, degrees=True)
    turn = Rotation.from_euler("yx", np.stack((np.linspace(-12, 12, FRAMES), np.linspace(4, -4, FRAMES)), 1), True)
    return RigidPoses((facing * turn).as_matrix(), np.tile([0.0, 0.0, 0.8], (FRAMES, 1)))


def drawn_mask(poses: RigidPoses, frame: int) -> np.ndarray:
    pixels = project_to_pixels(poses[frame : frame + 1].to_camera(SCALP.points[None]), INTRINSICS)[0]
    hull = cv2.convexHull(np.round((pixels - 0.5) * 16).astype(np.int32))
    mask = np.zeros((SIZE, SIZE), np.uint8)
    cv2.fillConvexPoly(mask, hull, 255, shift=4)
    mask[int(pixels[:, 1].max()) - 20 :] = np.maximum(mask[int(pixels[:, 1].max()) - 20 :], 255)  # a body below
    return mask


def misled(truth: RigidPoses, degrees: np.ndarray) -> tuple[RigidPoses, np.ndarray, np.ndarray]:
    """RigidPoses off by a turn about the face, with the observed landmarks and the shapes that explain them there."""
    generator = np.random.default_rng(0)
    face = generator.uniform((-0.06, -0.07, 0.05), (0.06, 0.03, 0.075), (60, 3))
    extra = Rotation.from_euler("y", degrees[:, None], degrees=True).as_matrix()
    center = face.mean(axis=0)
    turned = truth.rotations @ extra
    shift = truth.translations + np.einsum(
        "tij,tj->ti", truth.rotations, center - np.einsum("tij,j->ti", extra, center)
    )
    wrong = RigidPoses(turned, shift)
    seen = truth.to_camera(face[None])
    shapes = np.einsum("tba,tnb->tna", wrong.rotations, seen - wrong.translations[:, None])
    return wrong, project_to_pixels(seen, INTRINSICS), shapes


def errors(poses: RigidPoses, truth: RigidPoses) -> np.ndarray:
    """Rotation errors, degrees."""
    apart = Rotation.from_matrix(poses.rotations @ truth.rotations.transpose(0, 2, 1))
    return np.degrees(apart.magnitude())


def cues_of(masks: list[np.ndarray], landmarks: np.ndarray, shapes: np.ndarray) -> tuple[OutlineCue, LandmarkCue]:
    distances = np.stack([signed_distances(mask) for mask in masks])
    seen = effective_observations(LandmarkObservations(landmarks, np.ones(landmarks.shape[:2])), 190.0)
    outline = OutlineCue(OutlineDistances(distances, distances.shape[2] / SIZE), SCALP, INTRINSICS, 190.0)
    return outline, LandmarkCue(seen, shapes, INTRINSICS)


def test_distance_to_a_straight_edge_is_read_in_pixels_of_the_image() -> None:
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[:, 200:] = 255
    outline = OutlineDistances(signed_distances(mask)[None], 128 / SIZE)
    places = np.array([[[180.0, 250.0], [200.0, 100.0], [230.0, 300.0], [-5.0, 20.0], [500.0, 250.0]]])
    found, known = sample_distances(outline, slice(0, 1), places)
    np.testing.assert_allclose(found[0, :3], [-20.0, 0.0, 30.0], atol=0.6)
    np.testing.assert_array_equal(known[0], [True, True, True, False, False])


def test_the_outline_is_the_farthest_vertex_in_every_direction() -> None:
    poses = true_poses()
    pixels = project_to_pixels(poses.to_camera(SCALP.points[None]), INTRINSICS)
    rows = outline_vertices(pixels, poses)
    assert rows.shape == (FRAMES, DIRECTIONS) and (rows >= 0).all()
    hull = cv2.convexHull(pixels[3].astype(np.float32))
    away = [abs(cv2.pointPolygonTest(hull, pixels[3, row].tolist(), True)) for row in rows[3]]
    assert np.median(away) < 0.5 and max(away) < 3


@pytest.mark.parametrize("degrees", [4.0, -3.0])
def test_the_outline_corrects_landmarks_biased_by_an_expression(degrees: float) -> None:
    truth = true_poses()
    wrong, landmarks, shapes = misled(truth, np.full(FRAMES, degrees))
    cues = cues_of([drawn_mask(truth, k) for k in range(FRAMES)], landmarks, shapes)
    found = fuse_poses(cues, wrong, 0.0)
    assert np.allclose(errors(wrong, truth), abs(degrees), atol=1e-6)
    assert errors(found, truth).max() < 0.5 * abs(degrees)
    outline, _ = cues
    assert np.median(outline.rms_distances(found)) < 0.5 * np.median(outline.rms_distances(wrong))


def test_true_poses_stay_and_a_bow_in_the_hair_rotates_no_head() -> None:
    truth = true_poses()
    right, landmarks, shapes = misled(truth, np.zeros(FRAMES))
    masks = [drawn_mask(truth, k) for k in range(FRAMES)]
    for mask in masks[::2]:
        cv2.circle(mask, (230, 70), 45, 255, -1)
    found = fuse_poses(cues_of(masks, landmarks, shapes), right, 0.0)
    assert errors(found, truth).max() < 1.0


def test_without_an_outline_landmarks_decide() -> None:
    truth = true_poses()
    wrong, landmarks, shapes = misled(truth, np.full(FRAMES, 3.0))
    blank = [np.full((SIZE, SIZE), 255, np.uint8)] * FRAMES
    found = fuse_poses(cues_of(blank, landmarks, shapes), wrong, 0.0)
    assert errors(found, wrong).max() < 1e-3
