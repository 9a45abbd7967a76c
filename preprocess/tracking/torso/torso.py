"""Rigid torso motion from the image motion of texture and outline, and the neck motion that follows from it.

The head's pose is in the camera, so shoulders that rest in the room swing in head space. Only a rigid pose is
estimated, and it is smoothed strongly: enough for shoulders to stay in place, too little to memorize frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from preprocess.tracking.geometry.projection import posed_vertices, project
from preprocess.tracking.geometry.rigid import PinholeIntrinsics, RigidPoses
from preprocess.tracking.geometry.smoothing import penalty, smooth
from preprocess.tracking.pose.outline_cue import OutlineDistances, signed_distances
from preprocess.tracking.torso.outline import outline_motions
from preprocess.tracking.torso.texture import TorsoTracker

MINIMUM_TRACKED_SHARE = 0.6
"""Share of frames in which the torso must have been tracked for its motion to be used."""
MAXIMUM_NECK_STRETCH = 0.03
"""Limit on the change of the neck's length, m; beyond it tracking of the torso failed (a cut, drift)."""
FACE_DEPTH = 0.07
"""Depth of the face behind the tip of the nose, m."""
CHEST_DEPTH, CHEST_DROP = 0.085, 0.08
"""Where the texture is compared: distance in front of the shoulders' outline and below it, m."""
MAXIMUM_TORSO_ROTATION = 0.2
"""Limit on yaw and pitch of the torso, rad; beyond it tracking of the texture failed."""
TORSO_CUTOFF = 2.5
"""Fastest torso motion that is kept, Hz."""


@dataclass(frozen=True)
class NeckJoints:
    """The two joints of the neck in head space, m: below the skull, and where the neck meets the shoulders."""

    upper: Float[np.ndarray, "3"]
    lower: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class TorsoImageMotions:
    """Similarities of the torso from the first frame's pixels to each frame's.

    Attributes:
        texture: Of the clothes on the chest, in front; None where they could not be tracked.
        outline: Of the shoulders' outline, at the torso's sides; the same as `texture` where there is no outline.
    """

    texture: Sequence[np.ndarray | None]
    outline: Sequence[np.ndarray | None]

    @property
    def tracked_frames(self) -> int:
        """Number of frames in which the torso was tracked."""
        return sum(motion is not None for motion in self.outline)

    @property
    def reliable(self) -> bool:
        """Whether the torso was tracked in enough frames for its motion to be used."""
        return self.tracked_frames >= MINIMUM_TRACKED_SHARE * len(self.outline)


def torso_image_motions(
    texture: Sequence[np.ndarray | None], outline: OutlineDistances, faces: Sequence[tuple[float, float]], fps: float
) -> TorsoImageMotions:
    """The texture's motion together with the outline's; see `outline_motions`."""
    return TorsoImageMotions(texture, outline_motions(texture, outline, np.array(faces), fps))


def torso_poses(
    motions: TorsoImageMotions,
    poses: RigidPoses,
    pivot: Float[np.ndarray, "3"],
    intrinsics: PinholeIntrinsics,
    fps: float,
) -> RigidPoses:
    """Torso-to-camera poses; at rest the torso is under the head's median pose.

    The outline gives translation and roll; yaw and pitch follow from the difference between its motion and that of the
    chest, which is nearer to the camera. A torso that was not tracked rests.

    Args:
        motions: Of the torso in the image.
        poses: Of the head.
        pivot: Center of the shoulders in head space, m.
        intrinsics: Of the camera.
        fps: Frames per second.
    """
    rest = _median_pose(poses)
    if not motions.reliable:
        return RigidPoses(
            rest.rotations.repeat(len(poses.rotations), 0), rest.translations.repeat(len(poses.rotations), 0)
        )
    tracked = np.array([motion is not None for motion in motions.outline])
    center = rest.to_camera(pivot[None, None])[0, 0]
    pairs = zip(motions.texture, motions.outline, strict=True)
    steps = np.array(
        [np.zeros(6) if out is None else _pose_step(out, inner, center, intrinsics) for inner, out in pairs]
    )
    textured = np.array([motion is not None for motion in motions.texture])
    if textured.any():
        steps[~textured, 3:5] = np.median(steps[textured, 3:5], axis=0)
    steps = steps - np.median(steps[tracked], axis=0)
    steps[:, 3:5] = np.clip(steps[:, 3:5], -MAXIMUM_TORSO_ROTATION, MAXIMUM_TORSO_ROTATION)
    steps = smooth(steps, tracked.astype(float), penalty(TORSO_CUTOFF, fps))
    rotations = Rotation.from_rotvec(steps[:, 3:]).as_matrix() @ rest.rotations
    return RigidPoses(rotations, center + steps[:, :3] - rotations @ pivot)


def track_torso(
    head: HeadModel,
    tracking: Tracking,
    images: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fps: float,
) -> Float[np.ndarray, "T 4 4"] | None:
    """Torso-to-camera poses for another tracker's head poses.

    None is returned if the torso cannot be tracked, the head model has none, or the tracking already moves it by
    rotations of root or neck.

    Args:
        head: Head model; vertices that follow its root joint are the torso.
        tracking: With the head pose in `world_to_camera`.
        images: 8-bit RGB frames; each is read once, by several threads.
        masks: 8-bit foreground, 255 = person; each is read once, by several threads.
        fps: Frames per second.
    """
    torso_joints = [head.joint_index(name) for name in ("root", "neck") if name in head.joint_names]
    torso_weights = head.skinning_weights[:, head.joint_index("root")].numpy()
    if tracking.joint_rotations[:, torso_joints].any() or not (torso_weights > 0.5).any():
        return None
    depth = np.where(torso_weights < 0.01, head.template[:, 2].numpy(), -np.inf)
    front = np.flatnonzero(depth > depth.max() - FACE_DEPTH)
    tracker, texture, distances, faces = TorsoTracker(), [], [], []
    frames = ordered_map(lambda row: (images[row], masks[row]), range(len(tracking.intrinsics)))
    for row, (image, mask) in enumerate(frames):
        face = posed_vertices(head, tracking, row)[front]
        pixels, _ = project(face, tracking.intrinsics[row], tracking.world_to_camera[row])
        faces.append((pixels[:, 1].min(), pixels[:, 1].max()))
        texture.append(tracker.motion(image, mask, pixels))
        distances.append(signed_distances(mask))
    motions = torso_image_motions(
        texture, OutlineDistances(np.stack(distances), distances[0].shape[1] / mask.shape[1]), faces, fps
    )
    if not motions.reliable:
        return None
    views, first = tracking.world_to_camera.astype(np.float64), tracking.intrinsics[0]
    translations = views[:, :3, 3] + np.einsum("tij,tj->ti", views[:, :3, :3], tracking.translation)
    intrinsics = PinholeIntrinsics(float(first[0, 0]), (float(first[0, 2]), float(first[1, 2])))
    pivot = (head.joint_regressor @ head.template)[head.joint_index("root")].numpy()
    return torso_poses(motions, RigidPoses(views[:, :3, :3], translations), pivot, intrinsics, fps).matrices()


def _median_pose(poses: RigidPoses) -> RigidPoses:
    """The median of the poses, as one pose."""
    mean = Rotation.from_matrix(poses.rotations).mean()
    offsets = (mean.inv() * Rotation.from_matrix(poses.rotations)).as_rotvec()
    median = mean * Rotation.from_rotvec(np.median(offsets, axis=0))
    return RigidPoses(median.as_matrix()[None], np.median(poses.translations, axis=0)[None])


def _pose_step(
    outline: np.ndarray, texture: np.ndarray | None, center: np.ndarray, intrinsics: PinholeIntrinsics
) -> Float[np.ndarray, "6"]:
    """Translation (m) and rotation (axis-angle, rad), in camera space, of a torso whose shoulders rest at `center`."""
    depth, scale = center[2], intrinsics.focal / center[2]
    size = np.hypot(outline[0, 0], outline[1, 0])
    roll = np.arctan2(outline[1, 0], outline[0, 0])
    at_rest = center[:2] * scale + np.asarray(intrinsics.center)
    new_depth = depth / np.clip(size, 0.5, 2.0)
    across = (outline[:2, :2] @ at_rest + outline[:2, 2] - intrinsics.center) * new_depth / intrinsics.focal
    shift = np.append(across, new_depth) - center
    if texture is None:
        return np.concatenate((shift, [0.0, 0.0, roll]))
    chest = np.append(at_rest[0], at_rest[1] + CHEST_DROP * scale)
    apart = (texture - outline)[:2] @ np.append(chest, 1.0) / scale
    return np.concatenate((shift, [apart[1] / CHEST_DEPTH, -apart[0] / CHEST_DEPTH, roll]))


@dataclass(frozen=True)
class NeckMotion:
    """Rotations of the neck's two joints and its stretch, which move the torso to its pose relative to the head.

    Attributes:
        upper: Rotation of the upper joint, axis-angle, rad; it swings the lower joint to its position.
        lower: Rotation of the lower joint, axis-angle, rad; it rotates the torso.
        stretch: Length of the neck minus that at rest, m; it changes as shoulders rise or the chin is lifted.
    """

    upper: Float[np.ndarray, "T 3"]
    lower: Float[np.ndarray, "T 3"]
    stretch: Float[np.ndarray, " T"]


def neck_motion(torso: RigidPoses, head: RigidPoses, joints: NeckJoints) -> NeckMotion:
    """Neck motion that moves the torso to its pose, exactly if the neck stretches by `MAXIMUM_NECK_STRETCH` at most."""
    relative = head.rotations.transpose(0, 2, 1) @ torso.rotations
    offset = np.einsum("tba,tb->ta", head.rotations, torso.translations - head.translations)
    target = np.einsum("tab,b->ta", relative, joints.lower) + offset
    arm, target_arm = joints.lower - joints.upper, target - joints.upper
    length, lengths = np.linalg.norm(arm), np.linalg.norm(target_arm, axis=1)
    arm, target_arm = arm / length, target_arm / lengths[:, None]
    axis = np.cross(arm, target_arm)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], target_arm @ arm)
    upper = axis * (angle[:, None] / np.maximum(sine, 1e-9))
    lower = Rotation.from_rotvec(upper).inv() * Rotation.from_matrix(relative)
    return NeckMotion(upper, lower.as_rotvec(), np.clip(lengths - length, -MAXIMUM_NECK_STRETCH, MAXIMUM_NECK_STRETCH))
