"""The torso's own motion, from how its texture and its outline move in the image, and the neck that follows from it.

The head's pose is in the camera, so shoulders that rest in the room swing in head space. Few numbers are measured
(a rigid pose), and slowly: enough for shoulders to stay where they are, too few to memorise frames.
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
from preprocess.tracking.geometry.rigid import Lens, Poses
from preprocess.tracking.geometry.smoothing import penalty, smooth
from preprocess.tracking.pose.outline_cue import Edges, reduced_distances
from preprocess.tracking.torso.outline import outline_motions
from preprocess.tracking.torso.texture import TorsoTracker

FOLLOWED = 0.6
"""Share of frames in which the torso must have been followed for its motion to be believed."""
STRETCHED = 0.03
"""Most that a neck's length changes, m; beyond it the torso was not followed but lost (a cut, a drift)."""
FACE_DEPTH = 0.07
"""How far behind the tip of the nose the face reaches, m."""
CHEST, BREAST = 0.085, 0.08
"""How far the chest lies in front of the shoulders' outline, and how far below them it is looked at, m."""
TURNED = 0.2
"""Most that a torso turns or leans, rad; beyond it the texture was lost."""
CUTOFF = 2.5
"""Fastest torso motion kept, Hz."""


@dataclass(frozen=True)
class TorsoPivots:
    """The two joints of the neck in head space, m: below the skull, and where the neck meets the shoulders."""

    upper: Float[np.ndarray, "3"]
    lower: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class TorsoMotions:
    """Similarities of the torso from the first frame's pixels to each frame's.

    Attributes:
        texture: Of the clothes on the chest, in front; None where they could not be followed.
        outline: Of the shoulders' outline, at the torso's sides; as `texture` where there is no outline.
    """

    texture: Sequence[np.ndarray | None]
    outline: Sequence[np.ndarray | None]

    @property
    def followed(self) -> int:
        """Frames in which the torso was followed."""
        return sum(motion is not None for motion in self.outline)

    @property
    def believed(self) -> bool:
        """Whether these are frames enough for the torso to move at all."""
        return self.followed >= FOLLOWED * len(self.outline)


def torso_motions(
    texture: Sequence[np.ndarray | None], edges: Edges, faces: Sequence[tuple[float, float]], fps: float
) -> TorsoMotions:
    """With the outline's motion; see `outline_motions`."""
    return TorsoMotions(texture, outline_motions(texture, edges, np.array(faces), fps))


def torso_poses(motions: TorsoMotions, poses: Poses, pivot: Float[np.ndarray, "3"], lens: Lens, fps: float) -> Poses:
    """Rigid pose of the torso in the camera; at rest it stands under the head's median pose.

    The outline tells how it shifts and rolls. Where the chest, which is nearer, moves otherwise, it turns or leans.
    A torso that was not followed rests.

    Args:
        motions: Of its image.
        poses: Of the head.
        pivot: Middle of the shoulders in head space, m.
        lens: Camera.
        fps: Frames a second.
    """
    rest = _median_pose(poses)
    if not motions.believed:
        return Poses(rest.rotations.repeat(len(poses.rotations), 0), rest.translations.repeat(len(poses.rotations), 0))
    seen = np.array([motion is not None for motion in motions.outline])
    middle = rest.to_camera(pivot[None, None])[0, 0]
    pairs = zip(motions.texture, motions.outline, strict=True)
    parts = np.array([np.zeros(6) if over is None else _motion_parts(over, on, middle, lens) for on, over in pairs])
    told = np.array([motion is not None for motion in motions.texture])
    if told.any():
        parts[~told, 3:5] = np.median(parts[told, 3:5], axis=0)
    parts = parts - np.median(parts[seen], axis=0)
    parts[:, 3:5] = np.clip(parts[:, 3:5], -TURNED, TURNED)
    parts = smooth(parts, seen.astype(float), penalty(CUTOFF, fps))
    rotations = Rotation.from_rotvec(parts[:, 3:]).as_matrix() @ rest.rotations
    return Poses(rotations, middle + parts[:, :3] - rotations @ pivot)


def followed_torso(
    head: HeadModel,
    tracking: Tracking,
    images: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fps: float,
) -> Float[np.ndarray, "T 4 4"] | None:
    """Torso-to-camera poses beside another tracker's head, or None where there is nothing to follow or no use for it.

    Args:
        head: Head model; what hangs on its root joint is the torso.
        tracking: With the head pose in the camera; a tracker that turns root or neck places the torso by itself.
        images: 8-bit RGB frames; each is asked for once, by several threads.
        masks: 8-bit foreground, 255 = person; the same.
        fps: Frames a second.
    """
    carried = [head.joint(name) for name in ("root", "neck") if name in head.joint_names]
    hung = head.skinning_weights[:, head.joint("root")].numpy()
    if tracking.joint_rotations[:, carried].any() or not (hung > 0.5).any():
        return None
    depth = np.where(hung < 0.01, head.template[:, 2].numpy(), -np.inf)
    front = np.flatnonzero(depth > depth.max() - FACE_DEPTH)
    tracker, texture, distances, faces = TorsoTracker(), [], [], []
    pictures = ordered_map(lambda row: (images[row], masks[row]), range(len(tracking.intrinsics)))
    for row, (image, mask) in enumerate(pictures):
        face = posed_vertices(head, tracking, row)[front]
        pixels, _ = project(face, tracking.intrinsics[row], tracking.world_to_camera[row])
        faces.append((pixels[:, 1].min(), pixels[:, 1].max()))
        texture.append(tracker.motion(image, mask, pixels))
        distances.append(reduced_distances(mask))
    motions = torso_motions(texture, Edges(np.stack(distances), distances[0].shape[1] / mask.shape[1]), faces, fps)
    if not motions.believed:
        return None
    views, first = tracking.world_to_camera.astype(np.float64), tracking.intrinsics[0]
    shifts = views[:, :3, 3] + np.einsum("tij,tj->ti", views[:, :3, :3], tracking.translation)
    lens = Lens(float(first[0, 0]), (float(first[0, 2]), float(first[1, 2])))
    pivot = (head.joint_regressor @ head.template)[head.joint("root")].numpy()
    return torso_poses(motions, Poses(views[:, :3, :3], shifts), pivot, lens, fps).matrices()


def _median_pose(poses: Poses) -> Poses:
    """One pose in the middle of the clip's."""
    mean = Rotation.from_matrix(poses.rotations).mean()
    offsets = (mean.inv() * Rotation.from_matrix(poses.rotations)).as_rotvec()
    middle = mean * Rotation.from_rotvec(np.median(offsets, axis=0))
    return Poses(middle.as_matrix()[None], np.median(poses.translations, axis=0)[None])


def _motion_parts(
    outline: np.ndarray, texture: np.ndarray | None, middle: np.ndarray, lens: Lens
) -> Float[np.ndarray, "6"]:
    """Shift (m) and turn (axis-angle, rad), both in camera space, of a torso whose shoulders rest at `middle`."""
    depth, scale = middle[2], lens.focal / middle[2]
    size = np.hypot(outline[0, 0], outline[1, 0])
    roll = np.arctan2(outline[1, 0], outline[0, 0])
    at_rest = middle[:2] * scale + np.asarray(lens.center)
    new_depth = depth / np.clip(size, 0.5, 2.0)
    across = (outline[:2, :2] @ at_rest + outline[:2, 2] - lens.center) * new_depth / lens.focal
    shift = np.append(across, new_depth) - middle
    if texture is None:
        return np.concatenate((shift, [0.0, 0.0, roll]))
    chest = np.append(at_rest[0], at_rest[1] + BREAST * scale)
    apart = (texture - outline)[:2] @ np.append(chest, 1.0) / scale
    return np.concatenate((shift, [apart[1] / CHEST, -apart[0] / CHEST, roll]))


@dataclass(frozen=True)
class NeckMotion:
    """What the two joints of the neck do to put the torso where it is, seen from the head.

    Attributes:
        upper: Turn of the upper joint, axis-angle, rad; it swings the lower joint towards its place.
        lower: Turn of the lower joint, axis-angle, rad; it turns the torso.
        stretch: How much longer the neck is than at rest, m: shoulders that rise, a chin that is lifted.
    """

    upper: Float[np.ndarray, "T 3"]
    lower: Float[np.ndarray, "T 3"]
    stretch: Float[np.ndarray, " T"]


def neck_motion(torso: Poses, head: Poses, pivots: TorsoPivots) -> NeckMotion:
    """The motion of the neck that reaches the torso's pose, exactly where its length changes by `STRETCHED` at most."""
    relative = head.rotations.transpose(0, 2, 1) @ torso.rotations
    offset = np.einsum("tba,tb->ta", head.rotations, torso.translations - head.translations)
    reached = np.einsum("tab,b->ta", relative, pivots.lower) + offset
    arm, wanted = pivots.lower - pivots.upper, reached - pivots.upper
    length, lengths = np.linalg.norm(arm), np.linalg.norm(wanted, axis=1)
    arm, wanted = arm / length, wanted / lengths[:, None]
    axis = np.cross(arm, wanted)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], wanted @ arm)
    upper = axis * (angle[:, None] / np.maximum(sine, 1e-9))
    lower = Rotation.from_rotvec(upper).inv() * Rotation.from_matrix(relative)
    return NeckMotion(upper, lower.as_rotvec(), np.clip(lengths - length, -STRETCHED, STRETCHED))
