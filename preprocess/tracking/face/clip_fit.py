"""From the landmarks of a whole clip to lens, head poses, a face of the subject's own and its motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.face.expression_basis import (
    JAW_SPREAD,
    LID_SPREAD,
    NAMED_SPREAD,
    OWN_SPREAD,
    Camera,
    Expectation,
    displacements,
    fit_motion,
    principal_axes,
    refine_axes,
    regress,
)
from preprocess.tracking.geometry.landmark_model import FaceModel, FaceMotion
from preprocess.tracking.geometry.landmark_topology import MESH_POINTS, anchoring, rigidity
from preprocess.tracking.geometry.rigid import (
    Lens,
    Observations,
    Poses,
    initial_poses,
    nearest_true,
    project,
    refine_poses,
    spread_evenly,
)
from preprocess.tracking.geometry.smoothing import penalty
from preprocess.tracking.head.expression_axes import AXES, axis_scores, score
from preprocess.tracking.head.generic_head import JOINT_NAMES, GenericHead
from preprocess.tracking.head.personal_head import PersonalShape, fit_shape, lid_axes
from preprocess.tracking.pose.bundle_adjustment import Adjusted, ShapePrior, adjust, prior_focal

FACE_WIDTH = 0.155
"""Width of the canonical face, m: the unit of landmark errors."""
SHARED_ERROR, OWN_ERROR = 0.4, 0.014
"""Landmark errors over the face's width.

The first counts as if all points of 100 frames erred alike (focal length, mean shape), the second is for one frame's
coefficients, where neighbours still err alike.
"""
UNSCORED = 3.0
"""Without scores, coefficients spread by so much more about rest than they do about what scores say."""
KEYFRAMES, SPREAD_FRAMES = 64, 32
LEARNING_FRAMES = 800
ROUNDS = 3
RIDGE = 0.002
JAW_OPENING = 0.30
"""Turn of the jaw for a full jawOpen score, rad."""
POSE_CUTOFF = 5.0
"""Fastest head motion kept, Hz."""


@dataclass(frozen=True)
class Clip:
    """Landmarks of all frames.

    Attributes:
        points: Image positions of the 478 landmarks, px; frames without a face repeat a neighbour.
        blendshapes: Scores in [0, 1]; all zero if there are none.
        seen: Whether a face was found.
        size: Width and height of the images, px.
        fps: Frames a second.
        center: Principal point, px; None is the image's centre.
    """

    points: Float[np.ndarray, "T 478 2"]
    blendshapes: Float[np.ndarray, "T 52"]
    seen: Bool[np.ndarray, " T"]
    size: tuple[int, int]
    fps: float
    center: tuple[float, float] | None = None

    @property
    def looseness(self) -> float:
        """How much farther than usual coefficients may be from what scores say: there may be no scores."""
        return 1.0 if self.blendshapes.any() else UNSCORED

    def observations(self, trust: Float[np.ndarray, " 468"], error: float) -> Observations:
        """Landmarks on the skin with inverse variances trust / error²; `error` in px."""
        weights = self.seen[:, None] * trust[None] / error**2
        return Observations(self.points[:, :MESH_POINTS], weights)


@dataclass(frozen=True)
class ClipFit:
    """What was found.

    Attributes:
        camera: Lens and head poses.
        model: Landmarks with their axes: named, own, then the two lids.
        motion: Coefficients in that order, and jaw.
        shape: The generic head in the subject's shape.
        focal_spread: Standard deviation of log focal length.
        energy: Share of the non-rigid motion's energy that the named axes, and those with the own ones, explain.
    """

    camera: Camera
    model: FaceModel
    motion: FaceMotion
    shape: PersonalShape
    focal_spread: float
    energy: tuple[float, float]


@dataclass(frozen=True)
class FoundCamera:
    """The rigid part of a fit.

    Attributes:
        camera: Lens and head poses.
        neutral: The face at resting scores, m.
        shapes: The face as scores alone predict it in every frame, m.
        focal_spread: Standard deviation of log focal length.
        width: Of the face in the image, px.
        smoothness: Penalty used for poses.
    """

    camera: Camera
    neutral: Float[np.ndarray, "468 3"]
    shapes: Float[np.ndarray, "T 468 3"]
    focal_spread: float
    width: float
    smoothness: float


def find_camera(clip: Clip, face: CanonicalFace, focal: float | None, smooth: bool) -> FoundCamera:
    """Focal length, head poses and neutral landmarks.

    Args:
        clip: Landmarks.
        face: Canonical face.
        focal: Known focal length, px; None finds it.
        smooth: Smooth head poses over time.
    """
    trust = rigidity(face) * anchoring(face)
    found, lens = _start(clip, face, trust, focal)
    width = float(lens.focal * FACE_WIDTH / np.median(found.translations[:, 2]))
    shared = clip.observations(trust, SHARED_ERROR * width)
    keys = keyframes(clip, found)
    start = Adjusted(lens, face.vertices, found[keys], 0.0)
    adjusted = _adjust(shared[keys], face, start, clip.blendshapes[keys, 1:], focal is not None)
    smoothness = penalty(POSE_CUTOFF, clip.fps) if smooth else 0.0
    poses = initial_poses(shared, adjusted.shape, adjusted.lens)
    camera = Camera(adjusted.lens, refine_poses(shared, adjusted.shape, adjusted.lens, poses, smoothness))
    camera, neutral, shapes = _neutral(clip, shared, camera, adjusted.shape, (flexibility(face), smoothness))
    return FoundCamera(camera, neutral, shapes, adjusted.focal_spread, width, smoothness)


def learn_face(
    clip: Clip, face: CanonicalFace, generic: GenericHead, own: int, found: FoundCamera, polished: bool = True
) -> ClipFit:
    """Fit everything that landmarks tell about the face, given the head's poses.

    Args:
        clip: Landmarks.
        face: Canonical face.
        generic: Generic head.
        own: How many axes of its own the subject gets.
        found: Camera and poses.
        polished: Learn axes and coefficients once more, each given the other.
    """
    exact = clip.observations(np.maximum(rigidity(face), 0.3), OWN_ERROR * found.width)
    shape = fit_shape(generic, found.neutral)
    fit = _learn(clip, exact, found.camera, generic, found.neutral, shape, own)
    if polished:
        fit = _polish(fit, clip, exact)
    shape = fit_shape(generic, fit.model.neutral)
    shape.joints[JOINT_NAMES.index("jaw")] = fit.model.jaw_pivot
    return dataclasses.replace(fit, shape=shape, focal_spread=found.focal_spread)


def _start(clip: Clip, face: CanonicalFace, trust: np.ndarray, focal: float | None) -> tuple[Poses, Lens]:
    """Poses of the canonical face, and the prior's focal length unless one is given."""
    observed = clip.observations(trust, 1.0)
    lens = Lens(focal or 2.0 * max(clip.size), clip.center or (clip.size[0] / 2, clip.size[1] / 2))
    poses = initial_poses(observed, face.vertices, lens)
    if focal is None:
        lens = dataclasses.replace(lens, focal=prior_focal(poses, lens))
        poses = initial_poses(observed, face.vertices, lens)
    return refine_poses(observed, face.vertices, lens, poses), lens


def keyframes(clip: Clip, poses: Poses) -> np.ndarray:
    """Frames for the bundle adjustment: evenly spread over the clip.

    And those whose head turns differ most from the others.
    """
    seen = np.flatnonzero(clip.seen)
    chosen = list(seen[spread_evenly(len(seen), KEYFRAMES)])
    turns = Rotation.from_matrix(poses.rotations).as_rotvec()[seen]
    distance = np.min(np.linalg.norm(turns[:, None] - turns[np.isin(seen, chosen)][None], axis=-1), axis=1)
    for _ in range(min(SPREAD_FRAMES, len(seen) - len(chosen))):
        farthest = int(np.argmax(distance))
        chosen.append(seen[farthest])
        distance = np.minimum(distance, np.linalg.norm(turns - turns[farthest], axis=1))
    return np.unique(chosen)


def _adjust(observed: Observations, face: CanonicalFace, start: Adjusted, scores: np.ndarray, hold: bool) -> Adjusted:
    """Bundle adjustment in turns with what expressions do, predicted from the scores."""
    prior, offsets = ShapePrior.around(face.vertices), np.zeros((1, MESH_POINTS, 3))
    centered, flexible = scores - scores.mean(axis=0), flexibility(face)
    current = adjust(observed, prior, start, None, hold_focal=True, iterations=10)
    for _ in range(ROUNDS):
        missed = displacements(observed, Camera(current.lens, current.poses), current.shape + offsets)
        slopes, intercept = regress(missed, centered, RIDGE)
        offsets = offsets + np.einsum("nxs,ts->tnx", slopes * flexible, centered) + intercept
        begin = dataclasses.replace(current, lens=start.lens)
        current = adjust(observed, prior, begin, offsets, hold_focal=hold, iterations=10)
    return dataclasses.replace(current, shape=current.shape + offsets.mean(axis=0))


def resting_scores(blendshapes: Float[np.ndarray, "T 52"], seen: Bool[np.ndarray, " T"]) -> Float[np.ndarray, " 52"]:
    """What the network gives this subject's relaxed face: the lower fifth of each score."""
    return np.percentile(blendshapes[seen], 20, axis=0)


def flexibility(face: CanonicalFace) -> Float[np.ndarray, "468 1 1"]:
    """Share of each landmark's motion that may be expression where poses are found; without it.

    Expressions would explain head turns away.
    """
    return (1 - rigidity(face))[:, None, None]


def _neutral(
    clip: Clip, observed: Observations, camera: Camera, shape: np.ndarray, settings: tuple[np.ndarray, float]
) -> tuple[Camera, np.ndarray, np.ndarray]:
    """Poses refined with the expressions that scores predict, the face at resting scores, and as predicted.

    Settings are flexibility and smoothness.
    """
    flexible, smoothness = settings
    scores = (clip.blendshapes - resting_scores(clip.blendshapes, clip.seen))[:, 1:]
    neutral = shape
    for _ in range(2):
        used = strided(clip)
        missed = displacements(observed[used], Camera(camera.lens, camera.poses[used]), neutral)
        slopes, intercept = regress(missed, scores[used], RIDGE)
        neutral = neutral + intercept
        moving = neutral + np.einsum("nxs,ts->tnx", slopes * flexible, scores, optimize=True)
        camera = Camera(
            camera.lens, refine_poses(observed, moving, camera.lens, camera.poses, smoothness, iterations=3)
        )
    return camera, neutral, moving


def strided(clip: Clip) -> np.ndarray:
    """At most `LEARNING_FRAMES` frames with a face, evenly spread."""
    seen = np.flatnonzero(clip.seen)
    return seen[:: int(np.ceil(len(seen) / LEARNING_FRAMES))]


def _expectation(clip: Clip, own: int) -> Expectation:
    """Coefficients as the scores say; own axes are expected to rest."""
    change = clip.blendshapes - resting_scores(clip.blendshapes, clip.seen)
    lids = np.stack((score(change, "eyeBlinkLeft"), score(change, "eyeBlinkRight")), axis=1)
    coefficients = np.concatenate((axis_scores(change), np.zeros((len(change), own)), lids), axis=1)
    named, lid = NAMED_SPREAD * clip.looseness, LID_SPREAD * clip.looseness
    spreads = np.concatenate((np.full(len(AXES), named), np.full(own, OWN_SPREAD), np.full(2, lid)))
    jaw = np.stack((JAW_OPENING * score(change, "jawOpen"), np.zeros(len(change))), axis=1)
    return Expectation(coefficients, spreads, jaw, JAW_SPREAD * clip.looseness)


def _learn(
    clip: Clip,
    observed: Observations,
    camera: Camera,
    generic: GenericHead,
    neutral: np.ndarray,
    shape: PersonalShape,
    own: int,
) -> ClipFit:
    """Axes: generic ones corrected by the clip, then the subject's own."""
    jaw = JOINT_NAMES.index("jaw")
    given = (generic.landmarks @ generic.axes.reshape(len(generic.vertices), -1)).reshape(MESH_POINTS, 3, -1)
    lids = lid_axes(neutral, shape)
    share = generic.landmarks @ generic.weights[:, jaw]
    simple = FaceModel(neutral, np.concatenate((given, lids), axis=2), share, shape.joints[jaw])
    used = strided(clip)
    local, seen = Camera(camera.lens, camera.poses[used]), observed[used]
    chosen = _expectation(clip, 0).frames(used)
    motion = fit_motion(seen, local, simple, chosen)
    explained = np.concatenate((chosen.coefficients[:, : len(AXES)], motion.coefficients[:, len(AXES) :]), axis=1)
    resting = displacements(seen, local, simple.shapes(np.zeros_like(explained), motion.jaw))
    missed = displacements(seen, local, simple.shapes(explained, motion.jaw))
    missed = np.matmul(simple.blends(motion.jaw).transpose(0, 1, 3, 2), missed[..., None])[..., 0]
    slopes, intercept = regress(missed, chosen.coefficients[:, : len(AXES)], RIDGE)
    left = missed - intercept - np.einsum("nxa,ta->tnx", slopes, chosen.coefficients[:, : len(AXES)], optimize=True)
    axes, kept = principal_axes(left, own)
    energy = 1 - float((left**2).sum() / (resting**2).sum())
    model = dataclasses.replace(
        simple, neutral=neutral + intercept, axes=np.concatenate((given + slopes, axes, lids), axis=2)
    )
    motion = fit_motion(observed, camera, model, _expectation(clip, own))
    return ClipFit(camera, model, motion, shape, 0.0, (energy, energy + (1 - energy) * kept))


def _polish(fit: ClipFit, clip: Clip, observed: Observations) -> ClipFit:
    """Axes and coefficients once more, each given the other."""
    own = fit.model.axes.shape[2] - len(AXES) - 2
    learned = np.concatenate((np.ones(len(AXES) + own), np.zeros(2)))
    used = strided(clip)
    part = FaceMotion(fit.motion.coefficients[used], fit.motion.jaw[used])
    model = refine_axes(observed[used], Camera(fit.camera.lens, fit.camera.poses[used]), fit.model, part, learned)
    motion = fit_motion(observed, fit.camera, model, _expectation(clip, own))
    return dataclasses.replace(fit, model=model, motion=motion)


def reprojection(clip: Clip, camera: Camera, shapes: Float[np.ndarray, "T N 3"]) -> Float[np.ndarray, "T N"]:
    """Distance of landmarks from where the fit puts them, px; frames without a face repeat a neighbour."""
    seen = nearest_true(clip.seen)
    missed = clip.points[seen, :MESH_POINTS] - project(camera.poses.to_camera(shapes), camera.lens)
    return np.linalg.norm(missed, axis=-1)
