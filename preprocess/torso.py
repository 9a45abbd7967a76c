"""The torso's own motion: how the clothes below the chin move in the image, and the neck joints that follow from it.

The head's pose is in the camera, so shoulders that rest in the room swing in head space. Few numbers are measured
(shift, roll and size of the torso in the image), and slowly: enough for shoulders to stay where they are, too few to
memorise frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial.transform import Rotation

from ggavatar.capture import Tracking
from ggavatar.head.model import HeadModel
from preprocess.in_order import in_order
from preprocess.posing import posed_vertices, project
from preprocess.rigid import Lens, Poses
from preprocess.smoothing import penalty, smooth

TRACKING_WIDTH = 256
CORNERS = 120
ENOUGH = 12
FOLLOWED = 0.6
"""Share of frames in which the torso must have been followed for its motion to be believed."""
STRETCHED = 0.03
"""Most that a neck's length changes, m; beyond it the torso was not followed but lost (a cut, a drift)."""
FACE_DEPTH = 0.07
"""How far behind the tip of the nose the face reaches, m."""
CUTOFF = 2.5
"""Fastest torso motion kept, Hz."""


class TorsoTracker:
    """Follows the texture of the torso, frame after frame.

    Relative to a reference frame that is kept as long as it can be found again.
    """

    def __init__(self) -> None:
        self._reference: np.ndarray | None = None
        self._corners = np.zeros((0, 1, 2), np.float32)
        self._flow = np.zeros((0, 1, 2), np.float32)
        self._base = np.eye(3)
        self._last = np.eye(3)

    def motion(
        self, frame: UInt8[np.ndarray, "H W 3"], mask: UInt8[np.ndarray, "H W"], points: Float[np.ndarray, "N 2"] | None
    ) -> Float[np.ndarray, "3 3"] | None:
        """Similarity from the first frame's pixels to this frame's, or None where the torso could not be followed.

        Args:
            frame: RGB.
            mask: Foreground, 255 = person.
            points: Landmarks, px; None where no face was seen.
        """
        scale = TRACKING_WIDTH / frame.shape[1]
        small = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
        found = self._follow(grey)
        if found is None and points is not None:
            self._restart(
                grey, _torso_region(cv2.resize(mask, grey.shape[::-1], interpolation=cv2.INTER_AREA), points * scale)
            )
        self._last = self._last if found is None else found @ self._base
        if found is None and len(self._corners) < ENOUGH:
            return None
        zoom = np.diag([scale, scale, 1.0])
        return np.linalg.inv(zoom) @ self._last @ zoom

    def _follow(self, grey: np.ndarray) -> np.ndarray | None:
        """Similarity from the reference frame to this one."""
        if self._reference is None or len(self._corners) < ENOUGH:
            return None
        options: dict[str, Any] = {"winSize": (15, 15), "maxLevel": 2, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        moved, good, _ = cv2.calcOpticalFlowPyrLK(
            self._reference, grey, self._corners, self._corners + self._flow, **options
        )
        kept = good.ravel() > 0
        if kept.sum() < ENOUGH:
            return None
        matrix, inliers = cv2.estimateAffinePartial2D(self._corners[kept], moved[kept], ransacReprojThreshold=1.0)
        if matrix is None or inliers.sum() < max(ENOUGH, 0.4 * len(self._corners)):
            return None
        self._flow = cv2.transform(self._corners, matrix).astype(np.float32) - self._corners
        return np.vstack((matrix, (0, 0, 1)))

    def _restart(self, grey: np.ndarray, region: np.ndarray) -> None:
        """Make this frame the reference; its own motion is taken to be the last one known."""
        corners = cv2.goodFeaturesToTrack(grey, CORNERS, 0.01, 4, mask=region.astype(np.uint8))
        self._corners = np.zeros((0, 1, 2), np.float32) if corners is None else corners
        self._flow = np.zeros_like(self._corners)
        self._reference, self._base = grey, self._last


def _torso_region(mask: np.ndarray, points: np.ndarray) -> Bool[np.ndarray, "H W"]:
    """Foreground clearly below the chin."""
    low, high = points.min(axis=0), points.max(axis=0)
    rows = np.arange(mask.shape[0])[:, None]
    return (mask > 200) & (rows > high[1] + 0.22 * (high[1] - low[1]))


@dataclass(frozen=True)
class TorsoPivots:
    """The two joints of the neck in head space, m: below the skull, and where the neck meets the shoulders."""

    upper: Float[np.ndarray, "3"]
    lower: Float[np.ndarray, "3"]


def torso_poses(motions: list[np.ndarray | None], poses: Poses, lens: Lens, fps: float) -> Poses:
    """Rigid pose of the torso in the camera; at rest it stands under the head's median pose."""
    rest = _median_pose(poses)
    seen = np.array([motion is not None for motion in motions])
    parts = np.array([np.zeros(4) if motion is None else _similarity_parts(motion, rest, lens) for motion in motions])
    if seen.mean() < FOLLOWED:
        parts, seen = np.zeros_like(parts), np.ones(len(parts), bool)
    parts = parts - np.median(parts[seen], axis=0)
    parts = smooth(parts, seen.astype(float), penalty(CUTOFF, fps))
    turns = Rotation.from_rotvec(parts[:, 3:] * [0.0, 0.0, 1.0]).as_matrix()
    return Poses(turns @ rest.rotations, rest.translations + parts[:, :3])


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
    tracker, motions = TorsoTracker(), []
    pictures = in_order(lambda row: (images[row], masks[row]), range(len(tracking.intrinsics)))
    for row, (image, mask) in enumerate(pictures):
        face = posed_vertices(head, tracking, row)[front]
        pixels, _ = project(face, tracking.intrinsics[row], tracking.world_to_camera[row])
        motions.append(tracker.motion(image, mask, pixels))
    if np.mean([motion is not None for motion in motions]) < FOLLOWED:
        return None
    views, first = tracking.world_to_camera.astype(np.float64), tracking.intrinsics[0]
    shifts = views[:, :3, 3] + np.einsum("tij,tj->ti", views[:, :3, :3], tracking.translation)
    lens = Lens(float(first[0, 0]), (float(first[0, 2]), float(first[1, 2])))
    return torso_poses(motions, Poses(views[:, :3, :3], shifts), lens, fps).matrices()


def _median_pose(poses: Poses) -> Poses:
    """One pose in the middle of the clip's."""
    mean = Rotation.from_matrix(poses.rotations).mean()
    offsets = (mean.inv() * Rotation.from_matrix(poses.rotations)).as_rotvec()
    middle = mean * Rotation.from_rotvec(np.median(offsets, axis=0))
    return Poses(middle.as_matrix()[None], np.median(poses.translations, axis=0)[None])


def _similarity_parts(matrix: np.ndarray, rest: Poses, lens: Lens) -> np.ndarray:
    """Shift in camera space (m) and roll (rad) of the head's resting place carried along by an image similarity."""
    depth = rest.translations[0, 2]
    anchor = lens.focal * rest.translations[0, :2] / depth + np.asarray(lens.center)
    size = np.hypot(matrix[0, 0], matrix[1, 0])
    moved = matrix[:2, :2] @ anchor + matrix[:2, 2]
    new_depth = depth / np.clip(size, 0.5, 2.0)
    across = (moved - np.asarray(lens.center)) * new_depth / lens.focal
    return np.append(np.append(across, new_depth) - rest.translations[0], np.arctan2(matrix[1, 0], matrix[0, 0]))


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
