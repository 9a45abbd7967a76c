"""A head of FLAME's layout whose parameters are known is recovered from its own projected landmarks.

Also covers `preprocess/tracking/sequence.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.head.files import load_head, save_head
from ggavatar.head.flame import load_flame
from ggavatar.head.procedural.model import procedural_head
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.doctor.quality import landmark_error
from preprocess.options import TrackingOptions
from preprocess.tracking.face.clip_fit import CameraEstimate, ClipLandmarks
from preprocess.tracking.face.expression_basis import PosedCamera
from preprocess.tracking.face.flame_fit import (
    EMBEDDING_FILE,
    FlameLandmarks,
    fit_flame,
    flame_landmarks,
    read_embedding,
)
from preprocess.tracking.flame_tracker import track_flame
from preprocess.tracking.geometry.landmark_embedding import LandmarkEmbedding
from preprocess.tracking.geometry.landmark_model import FaceModel
from preprocess.tracking.geometry.rigid import PinholeIntrinsics, RigidPoses, project_to_pixels
from tests.support.procedural_identity import identity_basis

StandIn = tuple[CanonicalFace, LandmarkEmbedding]

EXPRESSIONS = 44
FRAMES = 24


@pytest.fixture(scope="module")
def flame_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural head as a file of FLAME's layout: identity first, then expression."""
    head = procedural_head()
    path = tmp_path_factory.mktemp("flame") / "generic_model.npz"
    shapes = identity_basis().numpy()
    np.savez(
        path,
        v_template=head.template.numpy(),
        f=head.faces.numpy().astype(np.uint32),
        weights=head.skinning_weights.numpy(),
        posedirs=np.zeros((len(shapes), 3, 36)),
        shapedirs=np.concatenate((shapes, head.expression_basis.numpy()), axis=2),
        J_regressor=head.joint_regressor.numpy(),
        kintree_table=np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], dtype=np.uint32),
    )
    return path


@dataclass(frozen=True)
class Truth:
    """Parameters that generated the projected landmarks."""

    model: FaceModel
    camera: PosedCamera
    jaw: np.ndarray


def projected(flame: FlameLandmarks) -> tuple[ClipLandmarks, Truth]:
    """Landmarks of a person who turns, speaks and opens the mouth, with noise of 0.2 px."""
    generator = np.random.default_rng(3)
    identity = np.zeros(flame.shapes.shape[2])
    identity[:8] = generator.normal(0, 1.2, 8)
    truth: FaceModel = flame.model(identity)
    coefficients = np.zeros((FRAMES, EXPRESSIONS + 2))
    coefficients[:, :6] = generator.normal(0, 0.3, (FRAMES, 6))
    jaw = np.stack((generator.uniform(0, 0.2, FRAMES), np.zeros(FRAMES)), axis=1)
    angles = generator.normal(0, [12, 18, 6], (FRAMES, 3))
    facing = Rotation.from_euler("x", 180, degrees=True)
    rotations = (facing * Rotation.from_euler("xyz", angles, degrees=True)).as_matrix()
    translations = np.column_stack((generator.normal(0, 0.03, (FRAMES, 2)), generator.uniform(0.7, 0.9, FRAMES)))
    intrinsics, poses = PinholeIntrinsics(900.0, (256.0, 256.0)), RigidPoses(rotations, translations)
    points = np.zeros((FRAMES, 478, 2))
    points[:, :468] = project_to_pixels(poses.to_camera(truth.shapes(coefficients, jaw)), intrinsics)
    points[:, :468] += generator.normal(0, 0.2, (FRAMES, 468, 2))
    clip = ClipLandmarks(points, np.zeros((FRAMES, 52)), np.ones(FRAMES, bool), (512, 512), 25.0)
    return clip, Truth(truth, PosedCamera(intrinsics, poses), jaw)


def test_recovers_identity_pose_and_jaw(flame_file: Path, stand_in: StandIn) -> None:
    face, embedding = stand_in
    flame = flame_landmarks(load_flame(flame_file, expressions=10_000), embedding, EXPRESSIONS)
    clip, truth = projected(flame)
    rotations, neutral = truth.camera.poses.rotations, truth.model.neutral
    found = CameraEstimate(truth.camera, neutral, np.tile(neutral, (FRAMES, 1, 1)), 0.0, 170.0, 0.0)

    fit = fit_flame(clip, flame, face, found)

    turned = Rotation.from_matrix(fit.camera.poses.rotations.transpose(0, 2, 1) @ rotations)
    assert np.degrees(turned.magnitude()).max() < 1.5
    assert fit.residual < 0.5
    missed = np.linalg.norm(flame.model(fit.identity).neutral - neutral, axis=1).mean()
    assert missed < 0.4 * np.linalg.norm(flame.template - neutral, axis=1).mean()
    assert np.corrcoef(fit.motion.jaw[:, 0], truth.jaw[:, 0])[0, 1] > 0.95


def test_embedding_of_another_topology_is_refused(flame_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "mediapipe_landmark_embedding.npz"
    np.savez(path, lmk_face_idx=np.array([10**6]), lmk_b_coords=np.ones((1, 3)) / 3, landmark_indices=np.array([4]))
    with pytest.raises(InputError, match=r"mediapipe_landmark_embedding\.npz"):
        read_embedding(path, load_flame(flame_file))


def test_a_head_that_is_not_flame_is_refused(tmp_path: Path, stand_in: StandIn) -> None:
    clip = ClipLandmarks(np.zeros((9, 478, 2)), np.zeros((9, 52)), np.ones(9, bool), (64, 64), 25.0)
    with pytest.raises(InputError, match="expected a FLAME model"):
        track_flame(clip, stand_in[0], tmp_path / "nothing.npz", TrackingOptions())


def test_the_head_model_holds_its_landmark_embedding(flame_file: Path, tmp_path: Path, stand_in: StandIn) -> None:
    """The doctor measures the nine tenths of the landmarks that are embedded; the fit's own residual agrees."""
    face, embedding = stand_in
    kept = np.setdiff1d(np.arange(468), np.arange(0, 468, 10))
    model = tmp_path / flame_file.name
    model.write_bytes(flame_file.read_bytes())
    triangles, corner = triangles_with(embedding.corners[kept, 0], load_flame(flame_file).faces.numpy())
    np.savez(tmp_path / EMBEDDING_FILE, lmk_face_idx=triangles, lmk_b_coords=np.eye(3)[corner], landmark_indices=kept)
    clip, _ = projected(flame_landmarks(load_flame(flame_file, expressions=10_000), embedding, EXPRESSIONS))
    sequence = track_flame(clip, face, model, TrackingOptions(900.0, EXPRESSIONS, smooth=False))

    save_head(sequence.head, tmp_path / "head.npz")
    head = load_head(tmp_path / "head.npz")
    capture = Capture(Path("nowhere"), "f", 512, 512, 25.0, tuple(range(FRAMES)), {}, sequence.tracking, head.version)
    error = landmark_error(capture, head)
    assert error is not None and error == pytest.approx(sequence.report["reprojection_px"]["median"], abs=0.3)
    assert head.landmark_weights is not None and not head.landmark_weights[::10].any()


def triangles_with(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex a triangle that has it, and as which corner."""
    found = [np.argwhere(faces == vertex)[0] for vertex in vertices]
    return np.array([place[0] for place in found]), np.array([place[1] for place in found])
