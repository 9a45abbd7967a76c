"""Fitting FLAME to a clip's landmarks: one identity, and pose, expression, jaw and lids of every frame.

FLAME is treated on its landmarks: shape and expression are linear, the jaw turns rigidly. Its pose correctives and the
small shift of joints with the expression are left out of the fit (they are in the head that is written).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from ggavatar.errors import InputError
from ggavatar.head.flame import IDENTITY_COEFFICIENTS, load_flame
from ggavatar.head.model import HeadModel
from ggavatar.io.npz import read_npz
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.face.clip_fit import JAW_OPENING, OWN_ERROR, Clip, FoundCamera, resting_scores, strided
from preprocess.tracking.face.expression_basis import JAW_SPREAD, LID_SPREAD, Camera, Expectation, fit_motion
from preprocess.tracking.geometry.landmark_embedding import Embedding, closest_points
from preprocess.tracking.geometry.landmark_model import FaceModel, FaceMotion
from preprocess.tracking.geometry.landmark_topology import lids, rigidity
from preprocess.tracking.geometry.rigid import (
    Observations,
    initial_poses,
    project,
    projection_slopes,
    refine_poses,
    robust_weights,
)
from preprocess.tracking.head.expression_axes import score
from preprocess.tracking.head.personal_head import similarity

EMBEDDING_FILE = "mediapipe_landmark_embedding.npz"
"""Landmarks on FLAME's triangles, looked for beside the model (metrical-tracker and others ship it)."""
SHAPES = 60
"""Identity coefficients that landmarks can tell apart."""
ROUNDS = 8
FARTHEST = 0.008
"""A landmark of the canonical face farther than this from FLAME's skin is not used, m."""


@dataclass(frozen=True)
class FlameLandmarks:
    """FLAME as its landmarks see it.

    Attributes:
        embedding: Which landmarks, and where they are on the model's triangles.
        template: Mean positions, m.
        shapes: Displacement per unit of each identity coefficient, m.
        expressions: The same for expressions, then the two lids.
        jaw_share: How far each landmark follows the jaw.
        joints: Joint positions of the mean head, m.
    """

    embedding: Embedding
    template: Float[np.ndarray, "L 3"]
    shapes: Float[np.ndarray, "L 3 S"]
    expressions: Float[np.ndarray, "L 3 E"]
    jaw_share: Float[np.ndarray, " L"]
    joints: Float[np.ndarray, "J 3"]

    def model(self, identity: Float[np.ndarray, " S"]) -> FaceModel:
        """Landmarks of a person."""
        return FaceModel(self.template + self.shapes @ identity, self.expressions, self.jaw_share, self.joints[2])


@dataclass(frozen=True)
class FlameFit:
    """What was found.

    Attributes:
        identity: Identity coefficients.
        camera: Lens and head poses.
        motion: Expression coefficients with the two lids last, and jaw.
        residual: Median distance of landmarks, px.
    """

    identity: Float[np.ndarray, " S"]
    camera: Camera
    motion: FaceMotion
    residual: float


def read_flame(path: Path, face: CanonicalFace, expressions: int) -> FlameLandmarks:
    """FLAME's landmarks from a model file, with the embedding beside it or found by laying the canonical face over it.

    Raises:
        InputError: Not a FLAME file, or a damaged embedding.
    """
    head = load_flame(path, expressions=10_000)
    beside = path.parent / EMBEDDING_FILE
    embedding = read_embedding(beside, head) if beside.is_file() else nearest_embedding(face, head)
    return flame_landmarks(head, embedding, expressions)


def flame_landmarks(head: HeadModel, embedding: Embedding, expressions: int) -> FlameLandmarks:
    """Landmarks of a head whose expression basis holds identity first, then expression (as FLAME's files do)."""
    basis = head.expression_basis.numpy().astype(np.float64)
    identities = min(IDENTITY_COEFFICIENTS, max(basis.shape[2] - expressions, 0))
    place = embedding.matrix(len(basis))
    template = head.template.numpy().astype(np.float64)
    moving = np.concatenate(
        (basis[:, :, identities : identities + expressions], head.eyelid_basis.numpy().astype(np.float64)), axis=2
    )
    return FlameLandmarks(
        embedding=embedding,
        template=place @ template,
        shapes=_at(place, basis[:, :, : min(identities, SHAPES)]),
        expressions=_at(place, moving),
        jaw_share=place @ head.skinning_weights.numpy().astype(np.float64)[:, 2],
        joints=head.joint_regressor.numpy().astype(np.float64) @ template,
    )


def _at(place: csr_array, values: np.ndarray) -> np.ndarray:
    return (place @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def read_embedding(path: Path, head: HeadModel) -> Embedding:
    """The published embedding of MediaPipe's landmarks on FLAME's triangles."""
    keys = ("lmk_face_idx", "lmk_b_coords", "landmark_indices")
    arrays = read_npz(path, keys)
    triangles, weights, landmarks = (np.asarray(arrays.get(key, np.zeros(0))) for key in keys)
    faces = head.faces.numpy()
    fits = triangles.ndim == 1 and weights.shape == (len(triangles), 3) and landmarks.shape == triangles.shape
    if not fits or not len(triangles) or triangles.max() >= len(faces) or landmarks.max() >= 468:
        raise InputError(f"{path}: expected {', '.join(keys)} for {len(faces)} triangles and 468 landmarks")
    return Embedding(landmarks.astype(np.int64), faces[triangles.astype(np.int64)], weights.astype(np.float64))


def nearest_embedding(face: CanonicalFace, head: HeadModel) -> Embedding:
    """Landmarks at the nearest points of the head's skin after laying the canonical face over it.

    Lids and lips are left out: their nearest points are not reliably theirs.
    """
    template, faces = head.template.numpy().astype(np.float64), head.faces.numpy()
    trusted = rigidity(face)
    usable = np.setdiff1d(np.flatnonzero(trusted >= 0.3), lids())
    placed = face.vertices.copy()
    front = template[np.abs(template[:, 0]) < 0.004]
    placed += front[front[:, 2].argmax()] - placed[placed[:, 2].argmax()]
    for _ in range(20):
        nearest = closest_points(placed[usable], template, faces)[0]
        scale, rotation, shift = similarity(placed[usable], nearest)
        placed = scale * placed @ rotation.T + shift
    candidates = np.setdiff1d(np.arange(len(placed)), lids())
    candidates = candidates[(trusted[candidates] >= 0.2) | (face.vertices[candidates, 1] < -0.065)]
    positions, corners, weights = closest_points(placed[candidates], template, faces)
    close = np.linalg.norm(positions - placed[candidates], axis=1) < FARTHEST
    return Embedding(candidates[close], corners[close], weights[close])


def fit_flame(clip: Clip, flame: FlameLandmarks, face: CanonicalFace, found: FoundCamera) -> FlameFit:
    """Alternate poses, expressions and identity, starting from the lens that the bundle adjustment found.

    Args:
        clip: Landmarks.
        flame: The model on its landmarks.
        face: Canonical face; says which landmarks hold still.
        found: Lens and size of the face; poses are found anew, since FLAME's head frame is its own.
    """
    seen = flame.embedding.landmarks
    trust = np.maximum(rigidity(face), 0.3)[seen]
    everything = clip.observations(np.maximum(rigidity(face), 0.3), OWN_ERROR * found.width)
    observed = Observations(
        everything.points[:, flame.embedding.landmarks], everything.weights[:, flame.embedding.landmarks]
    )
    rigid = dataclasses.replace(observed, weights=observed.weights * np.where(trust > 0.5, 1.0, 0.1))
    identity, lens = np.zeros(flame.shapes.shape[2]), found.camera.lens
    expected = _expectation(clip, flame.expressions.shape[2] - 2)
    poses = initial_poses(rigid, flame.template, lens)
    motion = FaceMotion(expected.coefficients, expected.jaw)
    for _ in range(ROUNDS):
        model = flame.model(identity)
        moving = model.shapes(motion.coefficients, motion.jaw)
        poses = refine_poses(rigid, moving, lens, poses, found.smoothness)
        camera = Camera(lens, poses)
        identity = _fit_identity(clip, observed, camera, flame, identity, motion)
        motion = fit_motion(observed, camera, flame.model(identity), expected)
    shapes = flame.model(identity).shapes(motion.coefficients, motion.jaw)
    missed = np.linalg.norm(observed.points - project(poses.to_camera(shapes), lens), axis=-1)[clip.seen]
    return FlameFit(identity, Camera(lens, poses), motion, float(np.median(missed)))


def _expectation(clip: Clip, expressions: int) -> Expectation:
    """Expressions about zero with FLAME's unit variance, lids and jaw as the scores say."""
    change = clip.blendshapes - resting_scores(clip.blendshapes, clip.seen)
    blinks = np.stack((score(change, "eyeBlinkLeft"), score(change, "eyeBlinkRight")), axis=1)
    coefficients = np.concatenate((np.zeros((len(change), expressions)), blinks), axis=1)
    spreads = np.concatenate((np.ones(expressions), np.full(2, LID_SPREAD * clip.looseness)))
    jaw = np.stack((JAW_OPENING * score(change, "jawOpen"), np.zeros(len(change))), axis=1)
    return Expectation(coefficients, spreads, jaw, JAW_SPREAD * clip.looseness)


def _fit_identity(
    clip: Clip,
    observed: Observations,
    camera: Camera,
    flame: FlameLandmarks,
    identity: Float[np.ndarray, " S"],
    motion: FaceMotion,
) -> Float[np.ndarray, " S"]:
    """One Gauss–Newton step of the identity from evenly spread frames, under its standard normal prior.

    The same person is in all frames and its landmarks err alike in all of them, so frames count as a few only.
    """
    used = strided(clip)
    model, share = flame.model(identity), min(1.0, 20 / len(used))
    jaw = motion.jaw[used]
    seen = camera.poses[used].to_camera(model.shapes(motion.coefficients[used], jaw))
    residuals = observed.points[used] - project(seen, camera.lens)
    weights = robust_weights(residuals, observed.weights[used], 3.0) * share
    slopes = projection_slopes(seen, camera.lens.focal)
    slopes = np.matmul(np.einsum("tnxa,tab->tnxb", slopes, camera.poses[used].rotations), model.blends(jaw))
    normal = np.einsum("tn,tnxa,tnxb->nab", weights, slopes, slopes, optimize=True)
    vector = np.einsum("tn,tnxa,tnx->na", weights, slopes, residuals, optimize=True)
    matrix = np.einsum("nas,nab,nbr->sr", flame.shapes, normal, flame.shapes, optimize=True)
    gradient = np.einsum("nas,na->s", flame.shapes, vector)
    return identity + np.linalg.solve(matrix + np.eye(len(identity)), gradient - identity)
