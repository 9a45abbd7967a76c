"""The texture cue and the pitch-bias correction on a synthetic face with known poses and sliding landmarks.

Also covers `preprocess/tracking/geometry/bilinear.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.landmarks.average_face import average_face
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry.landmark_topology import MESH_POINTS, lids, rigidity, surface_stability
from preprocess.tracking.geometry.rigid import LandmarkObservations, PinholeIntrinsics, RigidPoses, project_to_pixels
from preprocess.tracking.pose.fusion import LandmarkCue, effective_observations, fuse_poses
from preprocess.tracking.pose.landmark_pitch_bias import PitchBiasedLandmarkCue, pitch_angles, underreported_pitch
from preprocess.tracking.pose.texture_cue import TextureCue, robust_mean, skin_patches
from preprocess.tracking.pose.texture_images import CONTRAST_STEPS, IMAGE_SIDE, SkinImages, skin_image
from tests.support.freckled_face import freckled

SIZE, FRAMES = 256, 16
INTRINSICS = PinholeIntrinsics(1000.0, (128.0, 128.0))
PITCH = np.sin(np.linspace(0, 2 * np.pi, FRAMES))
YAW = 15 * np.cos(np.linspace(0, 4 * np.pi, FRAMES))
PITCH_BIAS = 0.25
"""Share of the pitch that the landmarks of these tests under-report, as those of the network do.

Measured in docs/experiments/2026-11-29-skin-texture-pose-cue.md.
"""


@pytest.fixture(scope="module")
def face() -> CanonicalFace:
    return average_face()


def posed(pitch: np.ndarray, yaw: np.ndarray | float = 0.0) -> RigidPoses:
    """A head one meter away with pitch and yaw in degrees."""
    facing = Rotation.from_euler("x", 180, degrees=True)
    turns = Rotation.from_euler("yx", np.stack((yaw + 0 * pitch, pitch), axis=1), degrees=True)
    return RigidPoses((facing * turns).as_matrix(), np.tile([0.0, 0.0, 1.0], (len(pitch), 1)))


def errors(poses: RigidPoses, truth: RigidPoses) -> np.ndarray:
    """Rotation errors without their constant part, degrees."""
    apart = Rotation.from_matrix(poses.rotations.transpose(0, 2, 1) @ truth.rotations)
    return np.degrees((apart.mean().inv() * apart).magnitude())


@pytest.fixture(scope="module")
def nodding(face: CanonicalFace) -> tuple[RigidPoses, RigidPoses, TextureCue, LandmarkCue]:
    """True poses, those that sliding landmarks report, and both cues."""
    truth, reported = posed(8 * PITCH), posed(8 * (1 - PITCH_BIAS) * PITCH)
    landmarks = project_to_pixels(reported.to_camera(face.vertices[None]), INTRINSICS)
    light = 1 - 0.2 * np.cos(np.arange(FRAMES))
    images = freckled(face.vertices, project_to_pixels(truth.to_camera(face.vertices[None]), INTRINSICS), SIZE, light)
    skin = SkinImages.stack([skin_image(image, points) for image, points in zip(images, landmarks, strict=True)])
    shapes, seen = np.tile(face.vertices, (FRAMES, 1, 1)), np.ones(FRAMES, bool)
    observed = LandmarkObservations(landmarks, np.tile(rigidity(face) * surface_stability(face), (FRAMES, 1)))
    landmark_cue = LandmarkCue(effective_observations(observed, 155.0), shapes, INTRINSICS)
    return truth, reported, TextureCue(skin, skin_patches(face), shapes, seen, INTRINSICS), landmark_cue


def test_patches_cover_the_face_but_not_the_eyes(face: CanonicalFace) -> None:
    patches = skin_patches(face)
    np.testing.assert_allclose(patches.weights.sum(axis=1), 1.0)
    assert (patches.weights > 0).all() and len(patches.rigidity) > 500
    assert not np.isin(patches.corners, lids()).all(axis=1).any()
    assert patches.corners.max() < MESH_POINTS and (patches.rigidity > 0).all() and (patches.rigidity <= 1).all()
    corners = face.vertices[patches.corners]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (outward[:, 2] > 0).all()


def test_sampled_contrast_and_its_gradient() -> None:
    ramp = np.tile(np.arange(SIZE, dtype=np.float32), (SIZE, 1))
    waves = (128 + 60 * np.sin(ramp / 4)).astype(np.uint8)
    points = np.array([[60.0, 70.0], [180.0, 170.0]])
    images = SkinImages.stack([skin_image(np.repeat(waves[..., None], 3, axis=2), points)])
    places = np.stack((np.linspace(80, 160, 60), np.full(60, 120.3)), axis=1)[None]
    intensities, slopes, known = images.sample(np.array([0]), places)
    shifted, _, _ = images.sample(np.array([0]), places + np.array([0.01, 0.0]))
    assert known.all()
    assert np.corrcoef(intensities[0], np.sin((places[0, :, 0] - 0.5) / 4))[0, 1] > 0.98
    np.testing.assert_allclose((shifted - intensities)[0] / 0.01, slopes[0, :, 0], atol=0.02, rtol=0.05)
    assert np.abs(slopes[..., 1]).max() < 0.05


def test_illumination_does_not_change_contrast() -> None:
    generator = np.random.default_rng(0)
    image = np.repeat(generator.integers(60, 120, (SIZE, SIZE, 1)), 3, axis=2).astype(np.uint8)
    points = np.array([[50.0, 50.0], [200.0, 200.0]])
    dark, bright = (skin_image(frame, points).contrast for frame in (image, 2 * image))
    assert np.abs(dark.astype(int) - bright).mean() < 0.1 * CONTRAST_STEPS


def test_the_skin_image_is_empty_without_a_face_and_padded_at_the_border() -> None:
    image = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3)).astype(np.uint8)
    assert not skin_image(image, None).contrast.any()
    outside = skin_image(image, np.array([[-300.0, -300.0], [-100.0, -100.0]]))
    assert outside.contrast.shape == (IMAGE_SIDE, IMAGE_SIDE) and not outside.contrast.any()
    assert skin_image(image, np.array([[-40.0, 200.0], [60.0, 300.0]])).contrast.any()


def test_texture_recovers_the_pitch_that_landmarks_under_report(nodding: tuple) -> None:
    truth, reported, skin, landmarks = nodding
    found = fuse_poses((skin, landmarks), reported, 0.0)
    assert errors(reported, truth).max() > 1.5
    assert errors(found, truth).max() < 0.5 * errors(reported, truth).max()


@dataclass(frozen=True)
class WeakCue:
    """A cue with the true poses and a large variance."""

    poses: RigidPoses
    precision: float

    def information(self, poses: RigidPoses) -> tuple[np.ndarray, np.ndarray]:
        turns = Rotation.from_matrix(self.poses.rotations @ poses.rotations.transpose(0, 2, 1)).as_rotvec()
        steps = np.concatenate((turns, self.poses.translations - poses.translations), axis=1)
        return np.tile(self.precision * np.eye(6), (FRAMES, 1, 1)), self.precision * steps

    def refined(self, poses: RigidPoses) -> WeakCue:
        return self


def longer_clip(observed: LandmarkObservations) -> LandmarkObservations:
    """Landmarks with the information of a clip of a hundred times as many frames, over which the bias is constant."""
    return LandmarkObservations(observed.points, 100 * observed.weights)


def test_the_pitch_bias_is_estimated_from_true_poses(nodding: tuple) -> None:
    truth, reported, _, landmarks = nodding
    cue = PitchBiasedLandmarkCue(replace(landmarks, observed=longer_clip(landmarks.observed)))
    for _ in range(12):
        cue = cue.refined(truth)
    np.testing.assert_allclose(cue.bias, [-PITCH_BIAS, 0, 0, 0, 0, 0], atol=0.01)
    assert underreported_pitch(reported, truth) == pytest.approx(PITCH_BIAS, abs=0.01)


def test_a_weak_cue_suffices_to_correct_the_pitch_bias(nodding: tuple) -> None:
    """It hardly counts against landmarks without a bias model."""
    truth, reported, _, landmarks = nodding
    landmarks = replace(landmarks, observed=longer_clip(landmarks.observed))
    weak = WeakCue(truth, 0.05 * float(np.median(landmarks.information(truth)[0][:, 0, 0])))
    plain, found = (fuse_poses((weak, one), reported, 0.0) for one in (landmarks, PitchBiasedLandmarkCue(landmarks)))
    assert errors(plain, truth).max() > 0.3 * errors(reported, truth).max()
    assert errors(found, truth).max() < 0.5 * errors(plain, truth).max()


def test_pitch_angles_are_rotations_about_the_cameras_x_axis_from_the_mean() -> None:
    np.testing.assert_allclose(pitch_angles(posed(8 * PITCH + 3)), np.radians(8 * PITCH), atol=1e-6)


def test_without_pitch_the_bias_stays_zero(nodding: tuple) -> None:
    """A head that only yaws leaves the bias at the prior's mean, in spite of landmark noise."""
    _, _, _, landmarks = nodding
    still = posed(np.zeros(FRAMES), YAW)
    noise = np.random.default_rng(0).normal(0, 0.5, (FRAMES, MESH_POINTS, 2))
    observed = LandmarkObservations(
        project_to_pixels(still.to_camera(landmarks.shapes), INTRINSICS) + noise, landmarks.observed.weights
    )
    cue = PitchBiasedLandmarkCue(LandmarkCue(observed, landmarks.shapes, INTRINSICS))
    assert np.abs(cue.refined(still).bias).max() < 1e-3


def test_patch_depths_are_estimated_from_parallax(face: CanonicalFace) -> None:
    """A texture that lies on a deeper face than the landmarks' surface, seen from several sides in known poses."""
    factor = 1.5
    depth = face.vertices[:, 2] - face.vertices[:, 2].mean()
    real = face.vertices + (factor - 1) * depth[:, None] * [0.0, 0.0, 1.0]
    truth = posed(8 * PITCH, YAW)
    pixels = project_to_pixels(truth.to_camera(real[None]), INTRINSICS)
    images = freckled(real, pixels, SIZE, np.ones(FRAMES))
    skin = SkinImages.stack([skin_image(image, points) for image, points in zip(images, pixels, strict=True)])
    cue = TextureCue(
        skin, skin_patches(face), np.tile(face.vertices, (FRAMES, 1, 1)), np.ones(FRAMES, bool), INTRINSICS
    )
    for _ in range(6):
        cue = cue.refined(truth)
    patches = cue.patches
    where = (patches.weights[..., None] * face.vertices[patches.corners]).sum(axis=1)
    inner = (np.abs(where[:, 0]) < 0.05) & (np.abs(where[:, 1]) < 0.06) & (patches.rigidity > 0.3)
    wanted = (factor - 1) * (where[:, 2] - face.vertices[:, 2].mean())[inner]
    found = (patches.modes @ cue.depths)[inner]
    left = (found - found.mean()) - (wanted - wanted.mean())
    assert np.abs(left).mean() < 0.5 * np.abs(wanted - wanted.mean()).mean()


def test_true_poses_stay(nodding: tuple) -> None:
    truth, _, skin, landmarks = nodding
    observed = LandmarkObservations(
        project_to_pixels(truth.to_camera(landmarks.shapes), INTRINSICS), landmarks.observed.weights
    )
    right = LandmarkCue(observed, landmarks.shapes, INTRINSICS)
    assert errors(fuse_poses((skin, right), truth, 0.0), truth).max() < 0.6


def test_a_displaced_frame_is_moved_back(nodding: tuple) -> None:
    """The Gauss–Newton step of a frame shifted by 0.3 mm (a third of a pixel) takes it back; the others stay."""
    truth, _, skin, _ = nodding
    shift = np.zeros((FRAMES, 6))
    shift[5, 3:5] = 3e-4, -2e-4
    information, gradient = skin.information(truth.moved(shift))
    steps = np.linalg.solve(information[:, 3:5, 3:5], gradient[:, 3:5, None])[..., 0]
    others = np.delete(steps, 5, axis=0)
    np.testing.assert_allclose(steps[5] + shift[5, 3:5], 0.0, atol=1e-4)
    assert np.abs(others).max() < 1e-4


def test_the_robust_mean_ignores_outliers() -> None:
    intensities = np.array([[1.0], [1.1], [0.9], [-3.0], [1.0]])
    assert robust_mean(intensities, np.ones((5, 1)))[0] == pytest.approx(1.0, abs=0.05)


def test_frames_without_a_face_have_no_information(nodding: tuple) -> None:
    truth, _, skin, _ = nodding
    seen = np.arange(FRAMES) != 3
    information, gradient = TextureCue(skin.images, skin.patches, skin.shapes, seen, INTRINSICS).information(truth)
    assert not information[3].any() and not gradient[3].any() and information[4].any()
