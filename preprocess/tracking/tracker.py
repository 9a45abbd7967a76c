"""The built-in tracker: from a clip's images and masks to cameras, head parameters and a head of the subject's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from jaxtyping import Float

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from ggavatar.landmarks.average_face import average_face
from ggavatar.landmarks.bundle import CanonicalFace, canonical_face
from ggavatar.landmarks.networks import FaceNetworkFiles
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained import catalogue
from preprocess.options import PrepOptions, TrackingOptions
from preprocess.tracking.face.clip_fit import ClipFit, FoundCamera, find_camera, learn_face, reprojection
from preprocess.tracking.face.gaze import CLOSED, centered_eyes, conjugate, eye_turns
from preprocess.tracking.flame_tracker import track_flame
from preprocess.tracking.geometry.landmark_topology import LEFT_IRIS, RIGHT_IRIS, anchoring, rigidity
from preprocess.tracking.geometry.rigid import Poses
from preprocess.tracking.geometry.smoothing import penalty, pose_jitter, smooth
from preprocess.tracking.head.expression_axes import AXES, score
from preprocess.tracking.head.generic_head import JOINT_NAMES, GenericHead, generic_head
from preprocess.tracking.head.personal_head import NECK_UNIT, assemble, move_eyes
from preprocess.tracking.head.silhouette_fit import fit_outline, outline_overlap, vertex_normals
from preprocess.tracking.observations import Watched, watch
from preprocess.tracking.pose.fusion import LandmarkEvidence, settle, trusted_landmarks
from preprocess.tracking.pose.landmark_nod_bias import NoddingLandmarks, hidden_share
from preprocess.tracking.pose.outline_cue import OutlineEvidence, Scalp
from preprocess.tracking.pose.texture_cue import SkinEvidence, face_spots
from preprocess.tracking.sequence import TrackedSequence
from preprocess.tracking.torso.torso import TorsoPivots, neck_motion, torso_poses

BLINK = 0.5
"""Score from which an eye counts as closed."""
WITHOUT_BUNDLE = (
    "face_landmarker.task is not to be had: landmarks are those of the mediapipe wheel, without expression scores; "
    "expression axes come from the clip's own motion alone"
)
EXPRESSION_CUTOFF, LID_CUTOFF = 6.0, 9.0
"""Fastest motion of expression and jaw, and of the lids, that is kept, Hz."""


def track(
    images: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fps: float,
    options: PrepOptions,
    center: tuple[float, float] | None = None,
) -> TrackedSequence:
    """Track a clip.

    Args:
        images: 8-bit RGB frames of one size; each is asked for once, by several threads.
        masks: 8-bit foreground, 255 = person; each is asked for once, by several threads.
        fps: Frames a second.
        options: Uses `models`, `offline`, `tracker` and `head_model`: a FLAME file is fitted instead of a head of the
            subject's own.
        center: Principal point, px of the images; None is their centre. A crop's is the centre of the video it is from.

    Raises:
        InputError: A model file is missing, or hardly a frame shows a face.
    """
    tracker, face = open_networks(options)

    def watched() -> Watched:
        found = watch(images, masks, fps, tracker)
        return dataclasses.replace(found, clip=dataclasses.replace(found.clip, center=center))

    if options.head_model is not None:
        return track_flame(watched().clip, face, options.head_model, options.tracker)
    with ThreadPoolExecutor(1, thread_name_prefix="generic-head") as aside:
        generic = aside.submit(generic_head, face)
        return track_landmarks(watched(), face, generic.result(), options)


def open_networks(options: PrepOptions) -> tuple[LandmarkTracker, CanonicalFace]:
    """The landmark networks and the average face: the bundle's, or what stands in where it is not to be had."""
    found = catalogue.resolve_with_substitutes("face_landmarker", options.models, options.offline)
    if len(found) == 1:
        return LandmarkTracker(found[0]), canonical_face(found[0])
    return LandmarkTracker(FaceNetworkFiles(*found)), average_face()


def track_landmarks(
    watched: Watched, face: CanonicalFace, generic: GenericHead, options: PrepOptions
) -> TrackedSequence:
    """Everything after the pictures have been looked at."""
    settings = options.tracker
    found = find_camera(watched.clip, face, settings.focal, settings.smooth)
    by_landmarks = found.camera.poses
    skin, nodding = _skin_and_landmarks(watched, face, found)
    found = _posed(found, settle((skin, nodding), by_landmarks, found.smoothness))
    fit, sequence = _with_face(watched, face, generic, settings, found, polished=False)
    outline, landmarks = _outline_and_landmarks(watched, fit, sequence.head, found)
    poses = settle((outline, landmarks, skin), found.camera.poses, found.smoothness)
    _, sequence = _with_face(watched, face, generic, settings, _posed(found, poses))
    distances = (float(np.median(outline.distances(here))) for here in (by_landmarks, poses))
    told = dict(zip(("by_landmarks", "settled"), (round(value, 2) for value in distances), strict=True))
    report = {
        **sequence.report,
        "scalp_to_outline_px": told,
        "nods_hidden_by_landmarks": round(hidden_share(by_landmarks, poses), 3),
    }
    return dataclasses.replace(sequence, report=report)


def _posed(found: FoundCamera, poses: Poses) -> FoundCamera:
    """With other poses."""
    return dataclasses.replace(found, camera=dataclasses.replace(found.camera, poses=poses))


def _skin_and_landmarks(
    watched: Watched, face: CanonicalFace, found: FoundCamera
) -> tuple[SkinEvidence, NoddingLandmarks]:
    """What decides on poses before the face is learnt, which would explain by expressions what poses leave."""
    clip, lens = watched.clip, found.camera.lens
    seen = trusted_landmarks(clip.observations(rigidity(face) * anchoring(face), 1.0), found.width)
    skin = SkinEvidence(watched.skin, face_spots(face), found.shapes, clip.seen, lens)
    return skin, NoddingLandmarks(LandmarkEvidence(seen, found.shapes, lens))


def _with_face(
    watched: Watched,
    face: CanonicalFace,
    generic: GenericHead,
    settings: TrackingOptions,
    found: FoundCamera,
    polished: bool = True,
) -> tuple[ClipFit, TrackedSequence]:
    """Expressions, gaze and torso for given poses, and the head that they move; its outline needs no polish."""
    fit = learn_face(watched.clip, face, generic, max(0, settings.expressions - len(AXES)), found, polished)
    fit = _with_gaze_centered(watched, fit, generic)
    axes = fit.model.axes
    parts = (axes[:, :, : len(AXES)], axes[:, :, len(AXES) : -2], axes[:, :, -2:])
    head = assemble(generic, fit.shape, *parts)
    tracking = _tracking(watched, fit, settings.smooth)
    template = fit_outline(head, generic, tracking, watched.outlines)
    head = assemble(generic, dataclasses.replace(fit.shape, vertices=template), *parts)
    report = _report(watched, fit) | {"outline_overlap": round(outline_overlap(head, tracking, watched.outlines), 3)}
    return fit, TrackedSequence(tracking, head, report)


def _outline_and_landmarks(
    watched: Watched, fit: ClipFit, head: HeadModel, found: FoundCamera
) -> tuple[OutlineEvidence, LandmarkEvidence]:
    """What decides on poses once there is a head with an outline; no expression moves its scalp."""
    shapes = fit.model.shapes(fit.motion.coefficients, fit.motion.jaw)
    seen = trusted_landmarks(watched.clip.observations(np.ones(shapes.shape[1]), 1.0), found.width)
    template, rows = head.template.numpy().astype(np.float64), head.regions["scalp"].numpy()
    scalp = Scalp(template[rows], vertex_normals(template, head.faces.numpy())[rows])
    lens = found.camera.lens
    return OutlineEvidence(watched.edges, scalp, lens, found.width), LandmarkEvidence(seen, shapes, lens)


def _with_gaze_centered(watched: Watched, fit: ClipFit, generic: GenericHead) -> ClipFit:
    """Eyeballs moved to where the clip's usual gaze is level and parallel."""
    eyes = centered_eyes(_turns(watched, fit), fit.camera.poses, fit.shape.eyes, fit.shape.eye_radius)
    return dataclasses.replace(fit, shape=move_eyes(fit.shape, generic, eyes))


def _turns(watched: Watched, fit: ClipFit) -> np.ndarray:
    irises = watched.clip.points[:, [LEFT_IRIS[0], RIGHT_IRIS[0]]]
    return eye_turns(irises, fit.camera.lens, fit.camera.poses, fit.shape.eyes, fit.shape.eye_radius)


def _tracking(watched: Watched, fit: ClipFit, smoothed: bool) -> Tracking:
    """Parameters of all frames as arrays of the capture."""
    clip, camera = watched.clip, fit.camera
    weights = clip.seen.astype(float)
    count = len(clip.points)

    def steady(values: np.ndarray, cutoff: float) -> np.ndarray:
        flat = values.reshape(count, -1)
        return smooth(flat, weights, penalty(cutoff, clip.fps) if smoothed else 0.0).reshape(values.shape)

    joints = np.zeros((count, len(JOINT_NAMES), 3))
    joints[:, JOINT_NAMES.index("jaw"), :2] = steady(fit.motion.jaw, EXPRESSION_CUTOFF)
    lids = closing(steady(fit.motion.coefficients[:, -2:], LID_CUTOFF), clip.blendshapes)
    visible = weights * (lids.max(axis=1) < CLOSED)
    joints[:, 3:5] = conjugate(_turns(watched, fit), visible, clip.fps, smoothed)
    pivots = TorsoPivots(fit.shape.joints[JOINT_NAMES.index("cervical")], fit.shape.joints[JOINT_NAMES.index("torso")])
    torso = torso_poses(watched.torso, camera.poses, pivots.lower, camera.lens, clip.fps)
    neck = neck_motion(torso, camera.poses, pivots)
    joints[:, 5], joints[:, 6] = neck.upper, neck.lower
    expression = steady(fit.motion.coefficients[:, :-2], EXPRESSION_CUTOFF)
    return Tracking(
        intrinsics=np.tile(camera.lens.matrix(), (count, 1, 1)),
        world_to_camera=camera.poses.matrices(),
        expression=np.concatenate((expression, neck.stretch[:, None] / NECK_UNIT), axis=1),
        joint_rotations=joints,
        eyelids=lids,
        translation=np.zeros((count, 3)),
        landmarks=np.where(clip.seen[:, None, None], clip.points, np.nan),
    )


def closing(lids: Float[np.ndarray, "T 2"], blendshapes: Float[np.ndarray, "T 52"]) -> Float[np.ndarray, "T 2"]:
    """Lid values stretched so that the clip's blinks close the lids.

    The landmark network leaves a gap between closed lids. A clip without a blink is left as it is.
    """
    blinks = np.stack([score(blendshapes, name) for name in ("eyeBlinkLeft", "eyeBlinkRight")], axis=1)
    highest = np.percentile(lids, 99.5, axis=0)
    gain = np.where(np.percentile(blinks, 99.5, axis=0) > BLINK, 1 / np.clip(highest, 0.5, 1.0), 1.0)
    return np.clip(gain * lids, -0.3, 1.1)


def _report(watched: Watched, fit: ClipFit) -> dict[str, Any]:
    """Numbers that say how well it went."""
    clip = watched.clip
    missed = reprojection(clip, fit.camera, fit.model.shapes(fit.motion.coefficients, fit.motion.jaw))[clip.seen]
    lost = int((~clip.seen).sum())
    scored = bool(clip.blendshapes.any())
    lacking = [] if scored else [WITHOUT_BUNDLE]
    carried = f"no face in {lost} of {len(clip.seen)} frames; their pose is carried over from the neighbours"
    return {
        "tracker": "built-in",
        "networks": "face_landmarker" if scored else f"face_landmark and iris_landmark of {catalogue.WHEEL}",
        "focal_px": round(fit.camera.lens.focal, 1),
        "focal_spread": round(fit.focal_spread, 3),
        "distance_m": round(float(np.median(fit.camera.poses.translations[:, 2])), 3),
        "reprojection_px": {
            "median": round(float(np.median(missed)), 3),
            "p95": round(float(np.percentile(missed, 95)), 3),
        },
        "expression_energy": {"named": round(fit.energy[0], 4), "with_own": round(fit.energy[1], 4)},
        "jitter": {name: round(value, 4) for name, value in pose_jitter(fit.camera.poses).items()},
        "frames_without_face": lost,
        "torso_followed": watched.torso.followed,
        "notes": lacking,
        "warnings": [*lacking, carried][: len(lacking) + (lost > 0)],
    }
