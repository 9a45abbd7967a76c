"""The tracker without the face landmarker bundle: the average face, no scores, landmarks of a known motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.landmarks.average_face import average_face
from ggavatar.landmarks.networks import FaceNetworkFiles
from ggavatar.landmarks.tracker import LandmarkTracker
from preprocess.options import PrepOptions
from preprocess.tracking.face.clip_fit import ClipLandmarks
from preprocess.tracking.geometry.landmark_topology import (
    LEFT_IRIS,
    LOWER_LIP_MARGIN,
    RIGHT_IRIS,
    UPPER_LIP_MARGIN,
    surface_stability,
)
from preprocess.tracking.head.generic_head import JOINT_NAMES, GenericHead, generic_head
from preprocess.tracking.head.silhouette_fit import OutlineMasks
from preprocess.tracking.observations import Observations
from preprocess.tracking.pose.outline_cue import MASK_WIDTH, OutlineDistances, signed_distances
from preprocess.tracking.pose.texture_images import SkinImages, skin_image
from preprocess.tracking.torso.torso import TorsoImageMotions
from preprocess.tracking.tracker import track_landmarks
from tests.support.freckled_face import freckled

FRAMES, SIZE, FOCAL = 40, 512, 1100.0
NOISE = 0.3
"""Standard deviation of landmarks, px."""


@pytest.fixture(scope="module")
def generic() -> GenericHead:
    return generic_head(average_face())


def test_average_face_is_a_face_in_our_axes() -> None:
    points = average_face().vertices
    assert points.shape == (468, 3) and 0.12 < np.ptp(points[:, 0]) < 0.18
    assert points[:, 2].argmax() in (1, 4) and points[263, 0] > 0 > points[33, 0]
    assert points[10, 1] > points[1, 1] > points[13, 1] > points[152, 1]


def test_the_edge_of_the_face_is_least_stable() -> None:
    trust = surface_stability(average_face())
    assert trust[[1, 6, 168, 33, 263]].min() > 0.9 and trust[[234, 454]] == pytest.approx(0.1)
    assert (np.diff(trust[np.argsort(np.abs(average_face().vertices[:, 0]))]) <= 1e-12).all()


def performed(generic: GenericHead) -> tuple[Observations, np.ndarray, np.ndarray]:
    """Observations of a head that rotates and opens its mouth, its rotations and its jaw."""
    time = np.arange(FRAMES) / 25
    rotations = (
        Rotation.from_euler("x", 180, degrees=True)
        * Rotation.from_euler("yx", np.stack((22 * np.sin(2 * time), 9 * np.cos(3 * time)), axis=1), degrees=True)
    ).as_matrix()
    jaw = 0.12 * (1 - np.cos(5 * time))
    rest = generic.landmarks @ generic.vertices
    share, pivot = generic.landmarks @ generic.weights[:, 2], generic.joints[2]
    opened = np.einsum("tab,nb->tna", Rotation.from_euler("x", jaw[:, None]).as_matrix(), rest - pivot) + pivot
    points = rest + share[:, None] * (opened - rest)
    eyes = np.repeat([generic.joints[4], generic.joints[3]], 5, axis=0) + np.array([0.0, 0.0, 0.011])
    points = np.concatenate((points, np.tile(eyes, (FRAMES, 1, 1))), axis=1)
    seen = points @ rotations.transpose(0, 2, 1) + [0.0, 0.02, 1.05]
    pixels = FOCAL * seen[..., :2] / seen[..., 2:] + SIZE / 2
    pictures = freckled(rest, pixels[:, :468], SIZE, np.ones(FRAMES))
    pixels += np.random.default_rng(0).normal(0, NOISE, pixels.shape)
    clip = ClipLandmarks(pixels, np.zeros((FRAMES, 52)), np.ones(FRAMES, bool), (SIZE, SIZE), 25.0)
    masks = [silhouette(generic, rotation) for rotation in rotations]
    edges = OutlineDistances(np.stack([signed_distances(mask) for mask in masks]), MASK_WIDTH / SIZE)
    outlines = OutlineMasks(
        np.array([0]), cv2.resize(masks[0], (192, 192), interpolation=cv2.INTER_AREA)[None], 192 / SIZE
    )
    skin = SkinImages.stack([skin_image(*seen) for seen in zip(pictures, pixels, strict=True)])
    motions = TorsoImageMotions([None] * FRAMES, [None] * FRAMES)
    return Observations(clip, motions, outlines, edges, skin), rotations, jaw


def silhouette(generic: GenericHead, rotation: np.ndarray) -> np.ndarray:
    """Mask of the rotated head without its torso."""
    seen = generic.vertices[generic.weights[:, 0] < 0.01] @ rotation.T + [0.0, 0.02, 1.05]
    pixels = FOCAL * seen[:, :2] / seen[:, 2:] + SIZE / 2
    mask = np.zeros((SIZE, SIZE), np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.round((pixels - 0.5) * 16).astype(np.int32)), 255, shift=4)
    return mask


def test_the_torso_joint_replaces_the_root(generic: GenericHead) -> None:
    own, torso = generic.head.skinning_weights.numpy(), JOINT_NAMES.index("torso")
    np.testing.assert_allclose(generic.weights[: len(own), torso], own[:, 0], atol=1e-6)
    np.testing.assert_allclose(generic.weights.sum(axis=1), 1.0, atol=1e-6)
    assert (generic.weights[generic.regions["torso"], torso] == 1).all()
    assert not generic.weights[:, [0, JOINT_NAMES.index("cervical")]].any()


def test_poses_jaw_and_landmarks_are_recovered_without_scores(generic: GenericHead, tmp_path: Path) -> None:
    observations, rotations, jaw = performed(generic)
    found = track_landmarks(observations, average_face(), generic, PrepOptions(Path("clip"), tmp_path))
    turned = Rotation.from_matrix(found.tracking.world_to_camera[:, :3, :3].transpose(0, 2, 1) @ rotations)
    apart = np.degrees((turned * turned.mean().inv()).magnitude())
    assert np.median(apart) < 1.0
    assert found.report["reprojection_px"]["median"] < 2 * NOISE
    assert "wheel" in found.report["notes"][0] and found.report["notes"][0] in found.report["warnings"]
    assert "mediapipe" in found.report["networks"]
    assert found.head.landmark_weights is not None and len(found.head.regions["landmarks"]) == 3 * 468
    gap = np.linalg.norm(
        observations.clip.points[:, UPPER_LIP_MARGIN[5]] - observations.clip.points[:, LOWER_LIP_MARGIN[5]], axis=1
    )
    assert np.corrcoef(gap, jaw)[0, 1] > 0.95
    assert np.corrcoef(found.tracking.joint_rotations[:, JOINT_NAMES.index("jaw"), 0], jaw)[0, 1] > 0.9


@pytest.mark.weights
def test_the_wheels_networks_find_the_portraits_eyes(pretrained: Callable[[str], Path]) -> None:
    """On scikit-image's astronaut, against positions read off the image."""
    from skimage.data import astronaut

    files = [pretrained(name) for name in ("face_detection", "face_landmark_468", "iris_landmark")]
    tracker = LandmarkTracker(FaceNetworkFiles(*files))
    found = tracker.landmarks(astronaut())
    assert found is not None and found.presence > 0.9 and not tracker.has_blendshapes and not found.blendshapes.any()
    assert np.linalg.norm(found.points[RIGHT_IRIS[0]] - [203.4, 101.2]) < 3
    assert np.linalg.norm(found.points[LEFT_IRIS[0]] - [247.0, 103.2]) < 3
