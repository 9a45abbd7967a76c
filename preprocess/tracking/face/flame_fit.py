"""Fits FLAME to a clip's landmarks: one identity, and pose, expression, jaw and lids of every frame.

FLAME is reduced to its landmarks: shape and expression are linear, the jaw rotates rigidly. Pose correctives and the
small shift of joints with the expression are left out of the fit (they are in the head model that is written).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.head.flame import IDENTITY_COEFFICIENTS, load_flame
from ggavatar.head.model import HeadModel
from ggavatar.io.npz import read_npz
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.face.clip_fit import (
    FRAME_LANDMARK_STD,
    FULL_JAW_OPENING,
    CameraEstimate,
    ClipLandmarks,
    neutral_scores,
    training_frames,
)
from preprocess.tracking.face.expression_basis import JAW_STD, LID_STD, MotionPrior, PosedCamera, fit_motion
from preprocess.tracking.geometry.landmark_embedding import LandmarkEmbedding, at_landmarks, closest_points
from preprocess.tracking.geometry.landmark_model import FaceModel, FaceMotion
from preprocess.tracking.geometry.landmark_topology import MESH_POINTS, lids, rigidity
from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    initial_poses,
    project_to_pixels,
    projection_jacobian,
    refine_poses,
    robust_weights,
)
from preprocess.tracking.head.expression_axes import score
from preprocess.tracking.head.personal_head import similarity_transform

EMBEDDING_FILE = "mediapipe_landmark_embedding.npz"
"""Embedding of landmarks in FLAME's triangles, looked for beside the model (metrical-tracker and others ship it)."""
MAXIMUM_IDENTITY_COEFFICIENTS = 60
"""Identity coefficients that are fitted; landmarks do not constrain more."""
FIT_ROUNDS = 8
"""Alternations of poses, identity and motion."""
REGISTRATION_ROUNDS = 20
"""Steps of the iterative-closest-point registration of the canonical face."""
MAXIMUM_EMBEDDING_DISTANCE = 0.008
"""Landmarks of the canonical face farther than this from FLAME's skin are not used, m."""


@dataclass(frozen=True)
class FlameLandmarks:
    """FLAME reduced to its landmarks.

    Attributes:
        embedding: Indices of the landmarks and their positions on the model's triangles.
        template: Mean positions, m.
        shapes: Displacement per unit of each identity coefficient, m.
        expressions: Displacement per unit of each expression, then of the two lids, m.
        jaw_weights: Skinning weight of the jaw for each landmark.
        joints: Joint positions of the mean head, m.
    """

    embedding: LandmarkEmbedding
    template: Float[np.ndarray, "L 3"]
    shapes: Float[np.ndarray, "L 3 S"]
    expressions: Float[np.ndarray, "L 3 E"]
    jaw_weights: Float[np.ndarray, " L"]
    joints: Float[np.ndarray, "J 3"]

    def model(self, identity: Float[np.ndarray, " S"]) -> FaceModel:
        """The landmark model of an identity."""
        return FaceModel(self.template + self.shapes @ identity, self.expressions, self.jaw_weights, self.joints[2])


@dataclass(frozen=True)
class FlameFit:
    """Result of fitting FLAME.

    Attributes:
        identity: Identity coefficients.
        camera: Intrinsics and head poses.
        motion: Expression coefficients with the two lids last, and jaw.
        residual: Median reprojection error of landmarks, px.
    """

    identity: Float[np.ndarray, " S"]
    camera: PosedCamera
    motion: FaceMotion
    residual: float


def read_flame(path: Path, face: CanonicalFace, expressions: int) -> FlameLandmarks:
    """FLAME's landmarks from a model file.

    The embedding is read from `EMBEDDING_FILE` beside it, or found by registering the canonical face to the model.

    Raises:
        InputError: Not a FLAME file, or a damaged embedding.
    """
    head = load_flame(path, expressions=10_000)
    embedding_path = path.parent / EMBEDDING_FILE
    embedding = read_embedding(embedding_path, head) if embedding_path.is_file() else nearest_embedding(face, head)
    return flame_landmarks(head, embedding, expressions)


def flame_landmarks(head: HeadModel, embedding: LandmarkEmbedding, expressions: int) -> FlameLandmarks:
    """Landmarks of a head model whose expression basis holds identity first, then expression (as FLAME's files do)."""
    basis = head.expression_basis.numpy().astype(np.float64)
    identities = min(IDENTITY_COEFFICIENTS, max(basis.shape[2] - expressions, 0))
    to_landmarks = embedding.matrix(len(basis))
    template = head.template.numpy().astype(np.float64)
    expression_basis = np.concatenate(
        (basis[:, :, identities : identities + expressions], head.eyelid_basis.numpy().astype(np.float64)), axis=2
    )
    return FlameLandmarks(
        embedding=embedding,
        template=to_landmarks @ template,
        shapes=at_landmarks(to_landmarks, basis[:, :, : min(identities, MAXIMUM_IDENTITY_COEFFICIENTS)]),
        expressions=at_landmarks(to_landmarks, expression_basis),
        jaw_weights=to_landmarks @ head.skinning_weights.numpy().astype(np.float64)[:, 2],
        joints=head.joint_regressor.numpy().astype(np.float64) @ template,
    )


def read_embedding(path: Path, head: HeadModel) -> LandmarkEmbedding:
    """The published embedding of MediaPipe's landmarks in FLAME's triangles.

    Raises:
        InputError: An array is missing, has another shape, or does not fit the head's triangles.
    """
    keys = ("lmk_face_idx", "lmk_b_coords", "landmark_indices")
    arrays = read_npz(path, keys)
    triangles, weights, landmarks = (np.asarray(arrays.get(key, np.zeros(0))) for key in keys)
    faces = head.faces.numpy()
    fits = triangles.ndim == 1 and weights.shape == (len(triangles), 3) and landmarks.shape == triangles.shape
    if not fits or not len(triangles) or triangles.max() >= len(faces) or landmarks.max() >= MESH_POINTS:
        sizes = [
            f"{key} of shape {value.shape}" for key, value in zip(keys, (triangles, weights, landmarks), strict=True)
        ]
        largest = f", largest triangle {triangles.max()}" if fits and len(triangles) else ""
        raise InputError(
            f"{path}: expected {', '.join(keys)} for {len(faces)} triangles and {MESH_POINTS} landmarks, found "
            f"{', '.join(sizes)}{largest}; give the embedding of this FLAME file, or remove it to embed automatically"
        )
    return LandmarkEmbedding(landmarks.astype(np.int64), faces[triangles.astype(np.int64)], weights.astype(np.float64))


def nearest_embedding(face: CanonicalFace, head: HeadModel) -> LandmarkEmbedding:
    """Landmarks at the nearest points of the head's skin after registering the canonical face to it.

    Lids and lips are left out: nearest points are unreliable there.
    """
    template, faces = head.template.numpy().astype(np.float64), head.faces.numpy()
    rigid = rigidity(face)
    usable = np.setdiff1d(np.flatnonzero(rigid >= 0.3), lids())
    placed = face.vertices.copy()
    front = template[np.abs(template[:, 0]) < 0.004]
    placed += front[front[:, 2].argmax()] - placed[placed[:, 2].argmax()]
    for _ in range(REGISTRATION_ROUNDS):
        nearest = closest_points(placed[usable], template, faces)[0]
        scale, rotation, shift = similarity_transform(placed[usable], nearest)
        placed = scale * placed @ rotation.T + shift
    candidates = np.setdiff1d(np.arange(len(placed)), lids())
    candidates = candidates[(rigid[candidates] >= 0.2) | (face.vertices[candidates, 1] < -0.065)]
    positions, corners, weights = closest_points(placed[candidates], template, faces)
    close = np.linalg.norm(positions - placed[candidates], axis=1) < MAXIMUM_EMBEDDING_DISTANCE
    return LandmarkEmbedding(candidates[close], corners[close], weights[close])


def fit_flame(clip: ClipLandmarks, flame: FlameLandmarks, face: CanonicalFace, estimate: CameraEstimate) -> FlameFit:
    """Fit poses, expressions and identity in turn, starting from the intrinsics of the bundle adjustment.

    Args:
        clip: Landmarks.
        flame: The model reduced to its landmarks.
        face: Canonical face, which gives the rigidity of landmarks.
        estimate: Intrinsics and size of the face; poses are estimated anew, since FLAME has another head frame.
    """
    landmarks = flame.embedding.landmarks
    weights = np.maximum(rigidity(face), 0.3)
    all_landmarks = clip.skin_landmarks(weights, FRAME_LANDMARK_STD * estimate.face_width)
    observed = LandmarkObservations(all_landmarks.points[:, landmarks], all_landmarks.weights[:, landmarks])
    rigid_weights = observed.weights * np.where(weights[landmarks] > 0.5, 1.0, 0.1)
    rigid = dataclasses.replace(observed, weights=rigid_weights)
    identity, intrinsics = np.zeros(flame.shapes.shape[2]), estimate.camera.intrinsics
    prior = _motion_prior(clip, flame.expressions.shape[2] - 2)
    poses = initial_poses(rigid, flame.template, intrinsics)
    motion = FaceMotion(prior.coefficients, prior.jaw)
    for _ in range(FIT_ROUNDS):
        shapes = flame.model(identity).shapes(motion.coefficients, motion.jaw)
        poses = refine_poses(rigid, shapes, intrinsics, poses, estimate.smoothness)
        camera = PosedCamera(intrinsics, poses)
        identity = _fit_identity(clip, observed, camera, flame, identity, motion)
        motion = fit_motion(observed, camera, flame.model(identity), prior)
    shapes = flame.model(identity).shapes(motion.coefficients, motion.jaw)
    residuals = observed.points - project_to_pixels(poses.to_camera(shapes), intrinsics)
    errors = np.linalg.norm(residuals, axis=-1)[clip.found]
    return FlameFit(identity, PosedCamera(intrinsics, poses), motion, float(np.median(errors)))


def _motion_prior(clip: ClipLandmarks, expressions: int) -> MotionPrior:
    """Expressions about zero with FLAME's unit variance, lids and jaw as predicted from the scores."""
    change = clip.blendshapes - neutral_scores(clip.blendshapes, clip.found)
    blinks = np.stack((score(change, "eyeBlinkLeft"), score(change, "eyeBlinkRight")), axis=1)
    coefficients = np.concatenate((np.zeros((len(change), expressions)), blinks), axis=1)
    stds = np.concatenate((np.ones(expressions), np.full(2, LID_STD * clip.prior_scale)))
    jaw = np.stack((FULL_JAW_OPENING * score(change, "jawOpen"), np.zeros(len(change))), axis=1)
    return MotionPrior(coefficients, stds, jaw, JAW_STD * clip.prior_scale)


def _fit_identity(
    clip: ClipLandmarks,
    observed: LandmarkObservations,
    camera: PosedCamera,
    flame: FlameLandmarks,
    identity: Float[np.ndarray, " S"],
    motion: FaceMotion,
) -> Float[np.ndarray, " S"]:
    """One Gauss–Newton step of the identity from evenly spaced frames, under its standard normal prior.

    Errors of the landmarks are the same in all frames of a person, so all frames together count as a few only.
    """
    used = training_frames(clip)
    model, share = flame.model(identity), min(1.0, 20 / len(used))
    jaw = motion.jaw[used]
    points = camera.poses[used].to_camera(model.shapes(motion.coefficients[used], jaw))
    residuals = observed.points[used] - project_to_pixels(points, camera.intrinsics)
    weights = robust_weights(residuals, observed.weights[used], 3.0) * share
    jacobian = projection_jacobian(points, camera.intrinsics.focal)
    jacobian = np.einsum("tnxa,tab->tnxb", jacobian, camera.poses[used].rotations)
    jacobian = np.matmul(jacobian, model.blend_matrices(jaw))
    normal = np.einsum("tn,tnxa,tnxb->nab", weights, jacobian, jacobian, optimize=True)
    vector = np.einsum("tn,tnxa,tnx->na", weights, jacobian, residuals, optimize=True)
    matrix = np.einsum("nas,nab,nbr->sr", flame.shapes, normal, flame.shapes, optimize=True)
    gradient = np.einsum("nas,na->s", flame.shapes, vector)
    return identity + np.linalg.solve(matrix + np.eye(len(identity)), gradient - identity)
