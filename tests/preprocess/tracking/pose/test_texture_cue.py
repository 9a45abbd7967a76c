"""Poses held by the skin's texture, against a drawn face whose poses are known and landmarks that slide on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.landmarks.average_face import average_face
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry.landmark_topology import MESH_POINTS, anchoring, lids, rigidity
from preprocess.tracking.geometry.rigid import Lens, Observations, Poses, project
from preprocess.tracking.pose.fusion import LandmarkEvidence, settle, trusted_landmarks
from preprocess.tracking.pose.landmark_nod_bias import NoddingLandmarks, hidden_share, nods
from preprocess.tracking.pose.texture_cue import SkinEvidence, face_spots, usual
from preprocess.tracking.pose.texture_images import SIDE, STEPS, SkinPictures, skin_picture
from tests.support.freckled_face import freckled

SIZE, FRAMES = 256, 16
LENS = Lens(1000.0, (128.0, 128.0))
NOD = np.sin(np.linspace(0, 2 * np.pi, FRAMES))
SHAKE = 15 * np.cos(np.linspace(0, 4 * np.pi, FRAMES))
HIDDEN = 0.25
"""Share of a nod that the landmarks of these tests hide, as those of the network do.

Measured in docs/experiments/2026-11-29-skin-texture-pose-cue.md.
"""


@pytest.fixture(scope="module")
def face() -> CanonicalFace:
    return average_face()


def posed(nod: np.ndarray, shake: np.ndarray | float = 0.0) -> Poses:
    """A head a metre away that nods and shakes so many degrees."""
    facing = Rotation.from_euler("x", 180, degrees=True)
    turns = Rotation.from_euler("yx", np.stack((shake + 0 * nod, nod), axis=1), degrees=True)
    return Poses((facing * turns).as_matrix(), np.tile([0.0, 0.0, 1.0], (len(nod), 1)))


def errors(poses: Poses, truth: Poses) -> np.ndarray:
    """Degrees, without what is the same in all frames."""
    apart = Rotation.from_matrix(poses.rotations.transpose(0, 2, 1) @ truth.rotations)
    return np.degrees((apart.mean().inv() * apart).magnitude())


@pytest.fixture(scope="module")
def nodding(face: CanonicalFace) -> tuple[Poses, Poses, SkinEvidence, LandmarkEvidence]:
    """True poses, those that sliding landmarks tell, and the evidence of both kinds."""
    truth, told = posed(8 * NOD), posed(8 * (1 - HIDDEN) * NOD)
    landmarks = project(told.to_camera(face.vertices[None]), LENS)
    light = 1 - 0.2 * np.cos(np.arange(FRAMES))
    pictures = freckled(face.vertices, project(truth.to_camera(face.vertices[None]), LENS), SIZE, light)
    skin = SkinPictures.of([skin_picture(image, points) for image, points in zip(pictures, landmarks, strict=True)])
    shapes, seen = np.tile(face.vertices, (FRAMES, 1, 1)), np.ones(FRAMES, bool)
    observed = Observations(landmarks, np.tile(rigidity(face) * anchoring(face), (FRAMES, 1)))
    evidence = LandmarkEvidence(trusted_landmarks(observed, 155.0), shapes, LENS)
    return truth, told, SkinEvidence(skin, face_spots(face), shapes, seen, LENS), evidence


def test_spots_cover_the_face_but_not_the_eyes(face: CanonicalFace) -> None:
    spots = face_spots(face)
    np.testing.assert_allclose(spots.weights.sum(axis=1), 1.0)
    assert (spots.weights > 0).all() and len(spots.trust) > 500
    assert not np.isin(spots.corners, lids()).all(axis=1).any()
    assert spots.corners.max() < MESH_POINTS and (spots.trust > 0).all() and (spots.trust <= 1).all()
    corners = face.vertices[spots.corners]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (outward[:, 2] > 0).all()


def test_a_picture_knows_where_it_is_and_how_contrast_changes() -> None:
    ramp = np.tile(np.arange(SIZE, dtype=np.float32), (SIZE, 1))
    waves = (128 + 60 * np.sin(ramp / 4)).astype(np.uint8)
    points = np.array([[60.0, 70.0], [180.0, 170.0]])
    pictures = SkinPictures.of([skin_picture(np.repeat(waves[..., None], 3, axis=2), points)])
    places = np.stack((np.linspace(80, 160, 60), np.full(60, 120.3)), axis=1)[None]
    looks, slopes, known = pictures.sampled(np.array([0]), places)
    shifted, _, _ = pictures.sampled(np.array([0]), places + np.array([0.01, 0.0]))
    assert known.all()
    assert np.corrcoef(looks[0], np.sin((places[0, :, 0] - 0.5) / 4))[0, 1] > 0.98
    np.testing.assert_allclose((shifted - looks)[0] / 0.01, slopes[0, :, 0], atol=0.02, rtol=0.05)
    assert np.abs(slopes[..., 1]).max() < 0.05


def test_light_does_not_change_contrast() -> None:
    generator = np.random.default_rng(0)
    image = np.repeat(generator.integers(60, 120, (SIZE, SIZE, 1)), 3, axis=2).astype(np.uint8)
    points = np.array([[50.0, 50.0], [200.0, 200.0]])
    dark, bright = (skin_picture(picture, points).contrast for picture in (image, 2 * image))
    assert np.abs(dark.astype(int) - bright).mean() < 0.1 * STEPS


def test_where_there_is_no_face_the_picture_is_empty_and_a_face_at_the_edge_is_padded() -> None:
    image = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3)).astype(np.uint8)
    assert not skin_picture(image, None).contrast.any()
    outside = skin_picture(image, np.array([[-300.0, -300.0], [-100.0, -100.0]]))
    assert outside.contrast.shape == (SIDE, SIDE) and not outside.contrast.any()
    assert skin_picture(image, np.array([[-40.0, 200.0], [60.0, 300.0]])).contrast.any()


def test_nods_that_landmarks_hide_are_found_by_the_skin(nodding: tuple) -> None:
    truth, told, skin, landmarks = nodding
    found = settle((skin, landmarks), told, 0.0)
    assert errors(told, truth).max() > 1.5
    assert errors(found, truth).max() < 0.5 * errors(told, truth).max()


@dataclass(frozen=True)
class Told:
    """Evidence that knows the poses, but not well."""

    poses: Poses
    trust: float

    def information(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        turns = Rotation.from_matrix(self.poses.rotations @ poses.rotations.transpose(0, 2, 1)).as_rotvec()
        steps = np.concatenate((turns, self.poses.translations - poses.translations), axis=1)
        return np.tile(self.trust * np.eye(6), (FRAMES, 1, 1)), self.trust * steps

    def corrected(self, poses: Poses) -> Told:
        return self


def many(observed: Observations) -> Observations:
    """Worth as much as those of a clip of a hundred times as many frames: what is hidden is the clip's."""
    return Observations(observed.points, 100 * observed.weights)


def test_a_hidden_share_of_nods_is_learnt_from_true_poses(nodding: tuple) -> None:
    truth, told, _, landmarks = nodding
    evidence = NoddingLandmarks(replace(landmarks, observed=many(landmarks.observed)))
    for _ in range(12):
        evidence = evidence.corrected(truth)
    np.testing.assert_allclose(evidence.hidden, [-HIDDEN, 0, 0, 0, 0, 0], atol=0.01)
    assert hidden_share(told, truth) == pytest.approx(HIDDEN, abs=0.01)


def test_weak_evidence_suffices_to_take_nods_back(nodding: tuple) -> None:
    """Against landmarks whose nods are taken as they are it hardly counts."""
    truth, told, _, landmarks = nodding
    landmarks = replace(landmarks, observed=many(landmarks.observed))
    weak = Told(truth, 0.05 * float(np.median(landmarks.information(truth)[0][:, 0, 0])))
    plain, found = (settle((weak, one), told, 0.0) for one in (landmarks, NoddingLandmarks(landmarks)))
    assert errors(plain, truth).max() > 0.3 * errors(told, truth).max()
    assert errors(found, truth).max() < 0.5 * errors(plain, truth).max()


def test_nods_are_the_turn_about_the_cameras_x_axis_from_the_average() -> None:
    np.testing.assert_allclose(nods(posed(8 * NOD + 3)), np.radians(8 * NOD), atol=1e-6)


def test_without_nods_nothing_is_taken_for_hidden(nodding: tuple) -> None:
    """Heads that only shake leave the prior's zero, though landmarks are off at random."""
    _, _, _, landmarks = nodding
    still = posed(np.zeros(FRAMES), SHAKE)
    noise = np.random.default_rng(0).normal(0, 0.5, (FRAMES, MESH_POINTS, 2))
    observed = Observations(project(still.to_camera(landmarks.shapes), LENS) + noise, landmarks.observed.weights)
    evidence = NoddingLandmarks(LandmarkEvidence(observed, landmarks.shapes, LENS))
    assert np.abs(evidence.corrected(still).hidden).max() < 1e-3


def test_spots_learn_how_far_they_stand_before_the_skin(face: CanonicalFace) -> None:
    """A texture that lies on a deeper face than the landmarks' surface, seen from several sides in known poses."""
    factor = 1.5
    depth = face.vertices[:, 2] - face.vertices[:, 2].mean()
    real = face.vertices + (factor - 1) * depth[:, None] * [0.0, 0.0, 1.0]
    truth = posed(8 * NOD, SHAKE)
    pixels = project(truth.to_camera(real[None]), LENS)
    pictures = freckled(real, pixels, SIZE, np.ones(FRAMES))
    skin = SkinPictures.of([skin_picture(image, points) for image, points in zip(pictures, pixels, strict=True)])
    evidence = SkinEvidence(skin, face_spots(face), np.tile(face.vertices, (FRAMES, 1, 1)), np.ones(FRAMES, bool), LENS)
    for _ in range(6):
        evidence = evidence.corrected(truth)
    spots = evidence.spots
    where = (spots.weights[..., None] * face.vertices[spots.corners]).sum(axis=1)
    inner = (np.abs(where[:, 0]) < 0.05) & (np.abs(where[:, 1]) < 0.06) & (spots.trust > 0.3)
    wanted = (factor - 1) * (where[:, 2] - face.vertices[:, 2].mean())[inner]
    found = (spots.modes @ evidence.depths)[inner]
    left = (found - found.mean()) - (wanted - wanted.mean())
    assert np.abs(left).mean() < 0.5 * np.abs(wanted - wanted.mean()).mean()


def test_true_poses_stay(nodding: tuple) -> None:
    truth, _, skin, landmarks = nodding
    observed = Observations(project(truth.to_camera(landmarks.shapes), LENS), landmarks.observed.weights)
    right = LandmarkEvidence(observed, landmarks.shapes, LENS)
    assert errors(settle((skin, right), truth, 0.0), truth).max() < 0.6


def test_one_displaced_frame_is_told_where_to_go(nodding: tuple) -> None:
    """The Gauss–Newton step of a frame shifted by 0.3 mm (a third of a pixel) takes it back; the others stay."""
    truth, _, skin, _ = nodding
    shift = np.zeros((FRAMES, 6))
    shift[5, 3:5] = 3e-4, -2e-4
    information, gradient = skin.information(truth.moved(shift))
    steps = np.linalg.solve(information[:, 3:5, 3:5], gradient[:, 3:5, None])[..., 0]
    others = np.delete(steps, 5, axis=0)
    np.testing.assert_allclose(steps[5] + shift[5, 3:5], 0.0, atol=1e-4)
    assert np.abs(others).max() < 1e-4


def test_looks_that_few_frames_show_are_not_usual() -> None:
    looks = np.array([[1.0], [1.1], [0.9], [-3.0], [1.0]])
    assert usual(looks, np.ones((5, 1)))[0] == pytest.approx(1.0, abs=0.05)


def test_frames_without_a_face_tell_nothing(nodding: tuple) -> None:
    truth, _, skin, _ = nodding
    seen = np.arange(FRAMES) != 3
    information, gradient = SkinEvidence(skin.pictures, skin.spots, skin.shapes, seen, LENS).information(truth)
    assert not information[3].any() and not gradient[3].any() and information[4].any()
