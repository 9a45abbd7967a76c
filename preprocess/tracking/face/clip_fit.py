"""Fits intrinsics, head poses, the subject's face and its motion to the landmarks of a whole clip."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.face.expression_basis import (
    JAW_STD,
    LID_STD,
    NAMED_STD,
    PERSONAL_STD,
    MotionPrior,
    PosedCamera,
    fit_motion,
    landmark_displacements,
    principal_axes,
    refine_axes,
    ridge_regression,
)
from preprocess.tracking.geometry.landmark_embedding import at_landmarks
from preprocess.tracking.geometry.landmark_model import FaceModel, FaceMotion
from preprocess.tracking.geometry.landmark_topology import MESH_POINTS, rigidity, surface_stability
from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    PinholeIntrinsics,
    RigidPoses,
    evenly_spaced,
    initial_poses,
    nearest_true_index,
    project_to_pixels,
    refine_poses,
)
from preprocess.tracking.geometry.smoothing import penalty
from preprocess.tracking.head.expression_axes import axis_scores, score
from preprocess.tracking.head.generic_head import JOINT_NAMES, GenericHead
from preprocess.tracking.head.personal_head import PersonalShape, fit_shape, lid_axes
from preprocess.tracking.pose.bundle_adjustment import BundleEstimate, ShapePrior, bundle_adjust, prior_focal

FACE_WIDTH = 0.155
"""Width of the canonical face, m: the unit of landmark errors."""
SHARED_LANDMARK_STD, FRAME_LANDMARK_STD = 0.4, 0.014
"""Standard deviations of landmarks over the face's width.

The first is for what all frames share (focal length, mean shape): it counts as if all points of 100 frames had the same
error. The second is for one frame's coefficients, where errors of neighboring landmarks are still correlated.
"""
UNSCORED_PRIOR_SCALE = 3.0
"""Factor on the prior standard deviations of coefficients where there are no blendshape scores to predict them."""
EVEN_KEYFRAMES, POSE_KEYFRAMES = 64, 32
"""Keyframes that are evenly spaced, and those that are added for their head poses."""
MAXIMUM_TRAINING_FRAMES = 800
"""Frames from which axes are learned."""
BUNDLE_ROUNDS = 3
"""Alternations of bundle adjustment and expression regression."""
RIDGE = 0.002
"""Ridge penalty of regressions on blendshape scores; see `ridge_regression`."""
FULL_JAW_OPENING = 0.30
"""Rotation of the jaw at a jawOpen score of 1, rad."""
POSE_CUTOFF = 5.0
"""Fastest head motion that is kept, Hz."""


@dataclass(frozen=True)
class ClipLandmarks:
    """Landmarks of all frames.

    Attributes:
        points: Image positions of the 478 landmarks, px; frames without a face copy the nearest one with a face.
        blendshapes: Scores in [0, 1]; all zero if there are none.
        found: Whether a face was found.
        size: Width and height of the images, px.
        fps: Frames per second.
        center: Principal point, px; None is the image's center.
    """

    points: Float[np.ndarray, "T 478 2"]
    blendshapes: Float[np.ndarray, "T 52"]
    found: Bool[np.ndarray, " T"]
    size: tuple[int, int]
    fps: float
    center: tuple[float, float] | None = None

    @property
    def prior_scale(self) -> float:
        """Factor on the prior standard deviations of coefficients: larger without blendshape scores."""
        return 1.0 if self.blendshapes.any() else UNSCORED_PRIOR_SCALE

    def skin_landmarks(self, weights: Float[np.ndarray, " 468"], deviation: float) -> LandmarkObservations:
        """The landmarks on the skin with inverse variances weights / deviation², 1/px²."""
        precision = self.found[:, None] * weights[None] / deviation**2
        return LandmarkObservations(self.points[:, :MESH_POINTS], precision)


@dataclass(frozen=True)
class ClipFit:
    """Result of fitting a clip.

    Attributes:
        camera: Intrinsics and head poses.
        model: Landmarks with their axes: named, personal, then the two lids.
        motion: Coefficients in that order, and jaw.
        shape: The generic head in the subject's shape.
        log_focal_std: Standard deviation of log focal length.
        energy: Share of the non-rigid motion's energy that the named axes, and those with the personal ones, explain.
    """

    camera: PosedCamera
    model: FaceModel
    motion: FaceMotion
    shape: PersonalShape
    log_focal_std: float
    energy: tuple[float, float]


@dataclass(frozen=True)
class CameraEstimate:
    """The rigid part of a fit.

    Attributes:
        camera: Intrinsics and head poses.
        neutral: The face at neutral scores, m.
        shapes: The face in every frame as predicted from the scores alone, m.
        log_focal_std: Standard deviation of log focal length.
        face_width: In the image, px.
        smoothness: Penalty with which poses are smoothed.
    """

    camera: PosedCamera
    neutral: Float[np.ndarray, "468 3"]
    shapes: Float[np.ndarray, "T 468 3"]
    log_focal_std: float
    face_width: float
    smoothness: float


def estimate_camera(clip: ClipLandmarks, face: CanonicalFace, focal: float | None, smooth: bool) -> CameraEstimate:
    """Estimate focal length, head poses and neutral landmarks.

    Args:
        clip: Landmarks.
        face: Canonical face.
        focal: Known focal length, px; None estimates it.
        smooth: Smooth head poses over time.
    """
    weights = rigidity(face) * surface_stability(face)
    first, intrinsics = _initial_camera(clip, face, weights, focal)
    face_width = float(intrinsics.focal * FACE_WIDTH / np.median(first.translations[:, 2]))
    shared = clip.skin_landmarks(weights, SHARED_LANDMARK_STD * face_width)
    keys = keyframes(clip, first)
    start = BundleEstimate(intrinsics, face.vertices, first[keys], 0.0)
    bundle = _bundle_adjust(shared[keys], face, start, clip.blendshapes[keys, 1:], focal is not None)
    smoothness = penalty(POSE_CUTOFF, clip.fps) if smooth else 0.0
    poses = initial_poses(shared, bundle.shape, bundle.intrinsics)
    poses = refine_poses(shared, bundle.shape, bundle.intrinsics, poses, smoothness)
    camera = PosedCamera(bundle.intrinsics, poses)
    camera, neutral, shapes = _neutral(clip, shared, camera, bundle.shape, (nonrigidity(face), smoothness))
    return CameraEstimate(camera, neutral, shapes, bundle.log_focal_std, face_width, smoothness)


def fit_face(
    clip: ClipLandmarks,
    face: CanonicalFace,
    generic: GenericHead,
    personal: int,
    estimate: CameraEstimate,
    refine: bool = True,
) -> ClipFit:
    """Fit shape, axes and motion of the face, given the head's poses.

    Args:
        clip: Landmarks.
        face: Canonical face.
        generic: Generic head.
        personal: Number of axes of the subject's own.
        estimate: Camera and poses.
        refine: Fit axes and coefficients once more, each given the other.
    """
    observed = clip.skin_landmarks(np.maximum(rigidity(face), 0.3), FRAME_LANDMARK_STD * estimate.face_width)
    shape = fit_shape(generic, estimate.neutral)
    fit = _learn_axes(clip, observed, estimate.camera, generic, estimate.neutral, shape, personal)
    if refine:
        fit = _refine(fit, clip, observed)
    shape = fit_shape(generic, fit.model.neutral)
    shape.joints[JOINT_NAMES.index("jaw")] = fit.model.jaw_pivot
    return dataclasses.replace(fit, shape=shape, log_focal_std=estimate.log_focal_std)


def _initial_camera(
    clip: ClipLandmarks, face: CanonicalFace, weights: np.ndarray, focal: float | None
) -> tuple[RigidPoses, PinholeIntrinsics]:
    """Poses of the canonical face, and the prior's focal length unless one is given."""
    observed = clip.skin_landmarks(weights, 1.0)
    center = clip.center or (clip.size[0] / 2, clip.size[1] / 2)
    intrinsics = PinholeIntrinsics(focal or 2.0 * max(clip.size), center)
    poses = initial_poses(observed, face.vertices, intrinsics)
    if focal is None:
        intrinsics = dataclasses.replace(intrinsics, focal=prior_focal(poses, intrinsics))
        poses = initial_poses(observed, face.vertices, intrinsics)
    return refine_poses(observed, face.vertices, intrinsics, poses), intrinsics


def keyframes(clip: ClipLandmarks, poses: RigidPoses) -> np.ndarray:
    """Frames for bundle adjustment: evenly spaced ones, and those whose head rotations differ most from the others."""
    found = np.flatnonzero(clip.found)
    chosen = list(found[evenly_spaced(len(found), EVEN_KEYFRAMES)])
    rotations = Rotation.from_matrix(poses.rotations).as_rotvec()[found]
    distance = np.min(np.linalg.norm(rotations[:, None] - rotations[np.isin(found, chosen)][None], axis=-1), axis=1)
    for _ in range(min(POSE_KEYFRAMES, len(found) - len(chosen))):
        farthest = int(np.argmax(distance))
        chosen.append(found[farthest])
        distance = np.minimum(distance, np.linalg.norm(rotations - rotations[farthest], axis=1))
    return np.unique(chosen)


def _bundle_adjust(
    observed: LandmarkObservations, face: CanonicalFace, start: BundleEstimate, scores: np.ndarray, hold_focal: bool
) -> BundleEstimate:
    """Bundle adjustment, alternating with the expressions' displacements as predicted from the scores."""
    prior, offsets = ShapePrior.from_canonical(face.vertices), np.zeros((1, MESH_POINTS, 3))
    centered, flexible = scores - scores.mean(axis=0), nonrigidity(face)
    current = bundle_adjust(observed, prior, start, None, hold_focal=True, iterations=10)
    for _ in range(BUNDLE_ROUNDS):
        camera = PosedCamera(current.intrinsics, current.poses)
        residuals = landmark_displacements(observed, camera, current.shape + offsets)
        slopes, intercept = ridge_regression(residuals, centered, RIDGE)
        offsets = offsets + np.einsum("nxs,ts->tnx", slopes * flexible, centered) + intercept
        begin = dataclasses.replace(current, intrinsics=start.intrinsics)
        current = bundle_adjust(observed, prior, begin, offsets, hold_focal=hold_focal, iterations=10)
    return dataclasses.replace(current, shape=current.shape + offsets.mean(axis=0))


def neutral_scores(blendshapes: Float[np.ndarray, "T 52"], found: Bool[np.ndarray, " T"]) -> Float[np.ndarray, " 52"]:
    """Scores of the subject's relaxed face: the 20th percentile of each over the frames with a face."""
    return np.percentile(blendshapes[found], 20, axis=0)


def nonrigidity(face: CanonicalFace) -> Float[np.ndarray, "468 1 1"]:
    """Share of each landmark's motion that may be expression while poses are estimated.

    Unlimited expressions would explain rotations of the head away.
    """
    return (1 - rigidity(face))[:, None, None]


def _neutral(
    clip: ClipLandmarks,
    observed: LandmarkObservations,
    camera: PosedCamera,
    shape: np.ndarray,
    settings: tuple[np.ndarray, float],
) -> tuple[PosedCamera, np.ndarray, np.ndarray]:
    """Poses refined with the expressions that scores predict; the face at neutral scores, and as predicted per frame.

    The settings are `nonrigidity` and the smoothness of poses.
    """
    flexible, smoothness = settings
    scores = (clip.blendshapes - neutral_scores(clip.blendshapes, clip.found))[:, 1:]
    neutral = shape
    for _ in range(2):
        used = training_frames(clip)
        local = PosedCamera(camera.intrinsics, camera.poses[used])
        residuals = landmark_displacements(observed[used], local, neutral)
        slopes, intercept = ridge_regression(residuals, scores[used], RIDGE)
        neutral = neutral + intercept
        shapes = neutral + np.einsum("nxs,ts->tnx", slopes * flexible, scores, optimize=True)
        poses = refine_poses(observed, shapes, camera.intrinsics, camera.poses, smoothness, iterations=3)
        camera = PosedCamera(camera.intrinsics, poses)
    return camera, neutral, shapes


def training_frames(clip: ClipLandmarks) -> np.ndarray:
    """At most `MAXIMUM_TRAINING_FRAMES` frames with a face, evenly spaced."""
    found = np.flatnonzero(clip.found)
    return found[:: int(np.ceil(len(found) / MAXIMUM_TRAINING_FRAMES))]


def _motion_prior(clip: ClipLandmarks, personal: int) -> MotionPrior:
    """Coefficients as predicted from the scores; zero for personal axes."""
    change = clip.blendshapes - neutral_scores(clip.blendshapes, clip.found)
    lids = np.stack((score(change, "eyeBlinkLeft"), score(change, "eyeBlinkRight")), axis=1)
    coefficients = np.concatenate((axis_scores(change), np.zeros((len(change), personal)), lids), axis=1)
    named, lid = NAMED_STD * clip.prior_scale, LID_STD * clip.prior_scale
    stds = np.concatenate((np.full(len(TRACKED_AXES), named), np.full(personal, PERSONAL_STD), np.full(2, lid)))
    jaw = np.stack((FULL_JAW_OPENING * score(change, "jawOpen"), np.zeros(len(change))), axis=1)
    return MotionPrior(coefficients, stds, jaw, JAW_STD * clip.prior_scale)


def _learn_axes(
    clip: ClipLandmarks,
    observed: LandmarkObservations,
    camera: PosedCamera,
    generic: GenericHead,
    neutral: np.ndarray,
    shape: PersonalShape,
    personal: int,
) -> ClipFit:
    """Fit with generic axes corrected by the clip, then personal ones from the principal components of what is left."""
    jaw = JOINT_NAMES.index("jaw")
    generic_axes = at_landmarks(generic.landmarks, generic.axes)
    lids = lid_axes(neutral, shape)
    jaw_weights = generic.landmarks @ generic.weights[:, jaw]
    model = FaceModel(neutral, np.concatenate((generic_axes, lids), axis=2), jaw_weights, shape.joints[jaw])
    used = training_frames(clip)
    local, used_landmarks = PosedCamera(camera.intrinsics, camera.poses[used]), observed[used]
    prior = _motion_prior(clip, 0).frames(used)
    scores = prior.coefficients[:, : len(TRACKED_AXES)]
    motion = fit_motion(used_landmarks, local, model, prior)
    explained = np.concatenate((scores, motion.coefficients[:, len(TRACKED_AXES) :]), axis=1)
    without_axes = landmark_displacements(used_landmarks, local, model.shapes(np.zeros_like(explained), motion.jaw))
    residuals = landmark_displacements(used_landmarks, local, model.shapes(explained, motion.jaw))
    residuals = np.matmul(model.blend_matrices(motion.jaw).transpose(0, 1, 3, 2), residuals[..., None])[..., 0]
    slopes, intercept = ridge_regression(residuals, scores, RIDGE)
    residuals = residuals - intercept - np.einsum("nxa,ta->tnx", slopes, scores, optimize=True)
    axes, kept = principal_axes(residuals, personal)
    energy = 1 - float((residuals**2).sum() / (without_axes**2).sum())
    all_axes = np.concatenate((generic_axes + slopes, axes, lids), axis=2)
    model = dataclasses.replace(model, neutral=neutral + intercept, axes=all_axes)
    motion = fit_motion(observed, camera, model, _motion_prior(clip, personal))
    return ClipFit(camera, model, motion, shape, 0.0, (energy, energy + (1 - energy) * kept))


def _refine(fit: ClipFit, clip: ClipLandmarks, observed: LandmarkObservations) -> ClipFit:
    """Axes and coefficients once more, each given the other."""
    personal = fit.model.axes.shape[2] - len(TRACKED_AXES) - 2
    learned = np.concatenate((np.ones(len(TRACKED_AXES) + personal), np.zeros(2)))
    used = training_frames(clip)
    local = PosedCamera(fit.camera.intrinsics, fit.camera.poses[used])
    used_motion = FaceMotion(fit.motion.coefficients[used], fit.motion.jaw[used])
    model = refine_axes(observed[used], local, fit.model, used_motion, learned)
    motion = fit_motion(observed, fit.camera, model, _motion_prior(clip, personal))
    return dataclasses.replace(fit, model=model, motion=motion)


def reprojection_errors(
    clip: ClipLandmarks, camera: PosedCamera, shapes: Float[np.ndarray, "T N 3"]
) -> Float[np.ndarray, "T N"]:
    """Distance between observed and fitted landmarks, px; frames without a face copy the nearest one with a face."""
    nearest = nearest_true_index(clip.found)
    fitted = project_to_pixels(camera.poses.to_camera(shapes), camera.intrinsics)
    return np.linalg.norm(clip.points[nearest, :MESH_POINTS] - fitted, axis=-1)
