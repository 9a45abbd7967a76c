"""The built-in tracker: from a clip's images and masks to cameras, head parameters and a head model of the subject."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from jaxtyping import Float

from ggavatar.data.capture import Tracking
from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.model import HeadModel
from ggavatar.landmarks.average_face import average_face
from ggavatar.landmarks.bundle import CanonicalFace, canonical_face
from ggavatar.landmarks.networks import FaceNetworkFiles
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from ggavatar.pretrained.catalogue import MEDIAPIPE
from ggavatar.pretrained.resolve import resolve_with_substitutes
from preprocess.evidence.clip_faces import ClipFaces
from preprocess.options import PrepOptions, TrackingOptions
from preprocess.tracking.face.clip_fit import CameraEstimate, ClipFit, estimate_camera, fit_face, reprojection_errors
from preprocess.tracking.face.gaze import CLOSED_LID, centered_eyeballs, conjugate_gaze, eye_rotations
from preprocess.tracking.flame_tracker import track_flame
from preprocess.tracking.geometry.landmark_topology import LEFT_IRIS, RIGHT_IRIS, rigidity, surface_stability
from preprocess.tracking.geometry.rigid import RigidPoses
from preprocess.tracking.geometry.smoothing import penalty, pose_jitter, smooth
from preprocess.tracking.head.expression_axes import score
from preprocess.tracking.head.generic_head import JOINT_NAMES, GenericHead, generic_head
from preprocess.tracking.head.personal_head import NECK_UNIT, assemble_head, move_eyes
from preprocess.tracking.head.silhouette_fit import fit_silhouette, silhouette_overlap, vertex_normals
from preprocess.tracking.observations import Observations, observe
from preprocess.tracking.pose.fusion import LandmarkCue, effective_observations, fuse_poses
from preprocess.tracking.pose.landmark_pitch_bias import PitchBiasedLandmarkCue, underreported_pitch
from preprocess.tracking.pose.outline_cue import OutlineCue, ScalpSurface
from preprocess.tracking.pose.texture_cue import TextureCue, skin_patches
from preprocess.tracking.sequence import TrackedSequence
from preprocess.tracking.torso.torso import NeckJoints, neck_motion, torso_poses

BLINK_SCORE = 0.5
"""Blendshape score above which an eye counts as closed."""
WITHOUT_BUNDLE = (
    "face_landmarker.task is not available: landmarks are from the networks of the mediapipe wheel, without expression "
    "scores; expression axes are learned from the clip's own motion alone"
)
EXPRESSION_CUTOFF, LID_CUTOFF = 6.0, 9.0
"""Fastest motion of expression and jaw, and of the lids, that is kept, Hz."""


def track(
    images: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fps: float,
    options: PrepOptions,
    center: tuple[float, float] | None = None,
    faces: ClipFaces | None = None,
) -> TrackedSequence:
    """Track a clip.

    Args:
        images: 8-bit RGB frames of one size; each is read once, by several threads.
        masks: 8-bit foreground, 255 = person; each is read once, by several threads.
        fps: Frames per second.
        options: `models`, `offline`, `tracker` and `head_model` are used; with a `head_model`, that FLAME file is
            fitted instead of creating a head model of the subject.
        center: Principal point, px of the images; None is their center. For cropped images pass the center of the
            video they are cropped from.
        faces: Landmarks of the images, if they have been found already.

    Raises:
        InputError: A model file is missing, or too few frames show a face.
    """
    tracker, face = open_networks(options)

    def landmarks(row: int, image: np.ndarray) -> Landmarks | None:
        return tracker.landmarks(image) if faces is None else faces.at(row)

    def observed() -> Observations:
        observations = observe(images, masks, fps, landmarks)
        return dataclasses.replace(observations, clip=dataclasses.replace(observations.clip, center=center))

    if options.head_model is not None:
        return track_flame(observed().clip, face, options.head_model, options.tracker)
    with ThreadPoolExecutor(1, thread_name_prefix="generic-head") as executor:
        generic = executor.submit(generic_head, face)
        return track_landmarks(observed(), face, generic.result(), options)


def open_networks(options: PrepOptions) -> tuple[LandmarkTracker, CanonicalFace]:
    """The landmark networks and the average face: from the bundle, or their substitutes where it is not available."""
    found = resolve_with_substitutes("face_landmarker", options.models, options.offline)
    if len(found) == 1:
        return LandmarkTracker(found[0]), canonical_face(found[0])
    return LandmarkTracker(FaceNetworkFiles(*found)), average_face()


def track_landmarks(
    observations: Observations, face: CanonicalFace, generic: GenericHead, options: PrepOptions
) -> TrackedSequence:
    """Track a clip from what has been extracted from its frames; see `observations.observe`."""
    settings = options.tracker
    estimate = estimate_camera(observations.clip, face, settings.focal, settings.smooth)
    landmark_poses = estimate.camera.poses
    texture, landmarks = _face_cues(observations, face, estimate)
    estimate = _with_poses(estimate, fuse_poses((texture, landmarks), landmark_poses, estimate.smoothness))
    fit, sequence = _fit_head(observations, face, generic, settings, estimate, refine=False)
    outline, fitted_landmarks = _head_cues(observations, fit, sequence.head, estimate)
    cues = (outline, fitted_landmarks, texture)
    poses = fuse_poses(cues, estimate.camera.poses, estimate.smoothness)
    _, sequence = _fit_head(observations, face, generic, settings, _with_poses(estimate, poses))
    distances = {
        "by_landmarks": round(float(np.median(outline.rms_distances(landmark_poses))), 2),
        "settled": round(float(np.median(outline.rms_distances(poses))), 2),
    }
    report = {
        **sequence.report,
        "scalp_to_outline_px": distances,
        "nods_hidden_by_landmarks": round(underreported_pitch(landmark_poses, poses), 3),
    }
    return dataclasses.replace(sequence, report=report)


def _with_poses(estimate: CameraEstimate, poses: RigidPoses) -> CameraEstimate:
    return dataclasses.replace(estimate, camera=dataclasses.replace(estimate.camera, poses=poses))


def _face_cues(
    observations: Observations, face: CanonicalFace, estimate: CameraEstimate
) -> tuple[TextureCue, PitchBiasedLandmarkCue]:
    """Pose cues that need no head model.

    They are fused before the face is learned, whose expressions would otherwise explain errors of the poses.
    """
    clip, intrinsics = observations.clip, estimate.camera.intrinsics
    rigid = clip.skin_landmarks(rigidity(face) * surface_stability(face), 1.0)
    landmarks = LandmarkCue(effective_observations(rigid, estimate.face_width), estimate.shapes, intrinsics)
    texture = TextureCue(observations.skin, skin_patches(face), estimate.shapes, clip.found, intrinsics)
    return texture, PitchBiasedLandmarkCue(landmarks)


def _fit_head(
    observations: Observations,
    face: CanonicalFace,
    generic: GenericHead,
    settings: TrackingOptions,
    estimate: CameraEstimate,
    refine: bool = True,
) -> tuple[ClipFit, TrackedSequence]:
    """Expressions, gaze and torso for given poses, and the head model; its outline does not need `refine`."""
    fit = fit_face(observations.clip, face, generic, max(0, settings.expressions - len(TRACKED_AXES)), estimate, refine)
    fit = _with_gaze_centered(observations, fit, generic)
    axes = fit.model.axes
    parts = (axes[:, :, : len(TRACKED_AXES)], axes[:, :, len(TRACKED_AXES) : -2], axes[:, :, -2:])
    head = assemble_head(generic, fit.shape, *parts)
    tracking = _tracking(observations, fit, settings.smooth)
    masks = observations.outline_masks
    template = fit_silhouette(head, generic, tracking, masks)
    head = assemble_head(generic, dataclasses.replace(fit.shape, vertices=template), *parts)
    overlap = round(silhouette_overlap(head, tracking, masks), 3)
    return fit, TrackedSequence(tracking, head, _report(observations, fit) | {"outline_overlap": overlap})


def _head_cues(
    observations: Observations, fit: ClipFit, head: HeadModel, estimate: CameraEstimate
) -> tuple[OutlineCue, LandmarkCue]:
    """Pose cues that need a head model; no expression moves the scalp that the outline is compared with."""
    shapes = fit.model.shapes(fit.motion.coefficients, fit.motion.jaw)
    landmarks = observations.clip.skin_landmarks(np.ones(shapes.shape[1]), 1.0)
    template, rows = head.template.numpy().astype(np.float64), head.regions["scalp"].numpy()
    scalp = ScalpSurface(template[rows], vertex_normals(template, head.faces.numpy())[rows])
    intrinsics, face_width = estimate.camera.intrinsics, estimate.face_width
    outline = OutlineCue(observations.outline_distances, scalp, intrinsics, face_width)
    return outline, LandmarkCue(effective_observations(landmarks, face_width), shapes, intrinsics)


def _with_gaze_centered(observations: Observations, fit: ClipFit, generic: GenericHead) -> ClipFit:
    """The fit with its eyeballs moved to where the clip's median gaze is level and converges at the camera."""
    rotations = _eye_rotations(observations, fit)
    eyes = centered_eyeballs(rotations, fit.camera.poses, fit.shape.eyes, fit.shape.eye_radius)
    return dataclasses.replace(fit, shape=move_eyes(fit.shape, generic, eyes))


def _eye_rotations(observations: Observations, fit: ClipFit) -> np.ndarray:
    irises = observations.clip.points[:, [LEFT_IRIS[0], RIGHT_IRIS[0]]]
    return eye_rotations(irises, fit.camera.intrinsics, fit.camera.poses, fit.shape.eyes, fit.shape.eye_radius)


def _tracking(observations: Observations, fit: ClipFit, smoothed: bool) -> Tracking:
    """The fit as the arrays of a capture."""
    clip, camera = observations.clip, fit.camera
    weights = clip.found.astype(float)
    count = len(clip.points)

    def smooth_below(cutoff: float, values: np.ndarray) -> np.ndarray:
        flat = values.reshape(count, -1)
        return smooth(flat, weights, penalty(cutoff, clip.fps) if smoothed else 0.0).reshape(values.shape)

    joints = np.zeros((count, len(JOINT_NAMES), 3))
    joints[:, JOINT_NAMES.index("jaw"), :2] = smooth_below(EXPRESSION_CUTOFF, fit.motion.jaw)
    lids = rescaled_blinks(smooth_below(LID_CUTOFF, fit.motion.coefficients[:, -2:]), clip.blendshapes)
    visible = weights * (lids.max(axis=1) < CLOSED_LID)
    joints[:, 3:5] = conjugate_gaze(_eye_rotations(observations, fit), visible, clip.fps, smoothed)
    neck_joints = NeckJoints(
        fit.shape.joints[JOINT_NAMES.index("cervical")], fit.shape.joints[JOINT_NAMES.index("torso")]
    )
    torso = torso_poses(observations.torso, camera.poses, neck_joints.lower, camera.intrinsics, clip.fps)
    neck = neck_motion(torso, camera.poses, neck_joints)
    joints[:, 5], joints[:, 6] = neck.upper, neck.lower
    expression = smooth_below(EXPRESSION_CUTOFF, fit.motion.coefficients[:, :-2])
    return Tracking(
        intrinsics=np.tile(camera.intrinsics.matrix(), (count, 1, 1)),
        world_to_camera=camera.poses.matrices(),
        expression=np.concatenate((expression, neck.stretch[:, None] / NECK_UNIT), axis=1),
        joint_rotations=joints,
        eyelids=lids,
        translation=np.zeros((count, 3)),
        landmarks=np.where(clip.found[:, None, None], clip.points, np.nan),
    )


def rescaled_blinks(lids: Float[np.ndarray, "T 2"], blendshapes: Float[np.ndarray, "T 52"]) -> Float[np.ndarray, "T 2"]:
    """Lid values scaled so that the clip's blinks close the lids completely.

    The landmark network leaves a gap between closed lids. Lids of a clip without a blink are not scaled.
    """
    blinks = np.stack([score(blendshapes, name) for name in ("eyeBlinkLeft", "eyeBlinkRight")], axis=1)
    highest = np.percentile(lids, 99.5, axis=0)
    gain = np.where(np.percentile(blinks, 99.5, axis=0) > BLINK_SCORE, 1 / np.clip(highest, 0.5, 1.0), 1.0)
    return np.clip(gain * lids, -0.3, 1.1)


def _report(observations: Observations, fit: ClipFit) -> dict[str, Any]:
    """Measures of quality, notes and warnings."""
    clip = observations.clip
    shapes = fit.model.shapes(fit.motion.coefficients, fit.motion.jaw)
    errors = reprojection_errors(clip, fit.camera, shapes)[clip.found]
    lost = int((~clip.found).sum())
    scored = bool(clip.blendshapes.any())
    notes = [] if scored else [WITHOUT_BUNDLE]
    wheel = f"{MEDIAPIPE.project}=={MEDIAPIPE.version}"
    return {
        "tracker": "built-in",
        "networks": "face_landmarker" if scored else f"face_landmark and iris_landmark of {wheel}",
        "focal_px": round(fit.camera.intrinsics.focal, 1),
        "focal_spread": round(fit.log_focal_std, 3),
        "distance_m": round(float(np.median(fit.camera.poses.translations[:, 2])), 3),
        "reprojection_px": {
            "median": round(float(np.median(errors)), 3),
            "p95": round(float(np.percentile(errors, 95)), 3),
        },
        "expression_energy": {"named": round(fit.energy[0], 4), "with_own": round(fit.energy[1], 4)},
        "jitter": {name: round(value, 4) for name, value in pose_jitter(fit.camera.poses).items()},
        "frames_without_face": lost,
        "torso_followed": observations.torso.tracked_frames,
        "notes": notes,
        "warnings": notes,
    }
