"""Pose cue: the scalp's outline against the masks.

Landmarks alone are biased where an expression looks like a rotation of the head; the outline of the scalp is not.
Outlines far from the scalp (hair that moves by itself, hats, glasses) hardly count.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt8

from preprocess.tracking.geometry.bilinear import bilinear
from preprocess.tracking.geometry.rigid import (
    CHUNK,
    PinholeIntrinsics,
    RigidPoses,
    pose_jacobian,
    project_to_pixels,
    projection_jacobian,
    robust_weights,
)

MASK_WIDTH = 128
"""Width to which masks are downscaled, px."""
DISTANCE_STEPS = 8
"""Steps per downscaled pixel in which distances are stored."""
MAXIMUM_DISTANCE = 16.0
"""Distances are clipped here, downscaled px; an outline so far away is that of something else."""
DIRECTIONS = 36
"""Number of directions about the scalp's center; the farthest vertex in each is on the outline."""
MAXIMUM_ANGLE = np.radians(100)
"""Largest angle of these directions from upright: below, the outline is that of the face and the neck, not the hair."""
MINIMUM_IN_PLANE = 0.6
"""Smallest length of a unit normal's part in the image plane for its vertex to be on the outline."""
OUTLINE_STD = 0.010
"""Standard deviation of the hair's outline, over the face's width."""
EFFECTIVE_OUTLINE_POINTS = 12.0
"""Effective number of independent points on the whole outline."""


@dataclass(frozen=True)
class OutlineDistances:
    """Signed distances to the mask's outline in every frame.

    Attributes:
        distances: In 1/`DISTANCE_STEPS` px of the downscaled mask, positive inside, up to `MAXIMUM_DISTANCE`.
        scale: Size of the downscaled masks over that of the capture's images.
    """

    distances: Int8[np.ndarray, "T H W"]
    scale: float


def signed_distances(mask: UInt8[np.ndarray, "H W"]) -> Int8[np.ndarray, "h w"]:
    """One frame's distances for `OutlineDistances`; the image's border is no outline."""
    height = round(mask.shape[0] * MASK_WIDTH / mask.shape[1])
    inside = (cv2.resize(mask, (MASK_WIDTH, height), interpolation=cv2.INTER_AREA) > 127).astype(np.uint8)
    signed = cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)
    clipped = np.clip(signed, -MAXIMUM_DISTANCE, MAXIMUM_DISTANCE)
    halfway = clipped - 0.5 * np.sign(signed)  # the outline lies between two pixels
    return np.round(DISTANCE_STEPS * halfway).astype(np.int8)


@dataclass(frozen=True)
class ScalpSurface:
    """Vertices of the scalp (m) and their unit normals, in head space."""

    points: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]


@dataclass(frozen=True)
class OutlineCue:
    """The outlines of the masks and the scalp that projects to them.

    Attributes:
        outline: Distances to the outlines of the masks.
        scalp: The head's scalp.
        intrinsics: Of the camera.
        face_width: In the image, px.
    """

    outline: OutlineDistances
    scalp: ScalpSurface
    intrinsics: PinholeIntrinsics
    face_width: float

    def information(self, poses: RigidPoses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Information matrix and gradient of every frame's pose."""
        information, gradient, _ = self._evaluate(poses)
        return information, gradient

    def refined(self, poses: RigidPoses) -> OutlineCue:
        """Itself: this cue has no unknowns of its own."""
        return self

    def rms_distances(self, poses: RigidPoses) -> Float[np.ndarray, " T"]:
        """Root mean square distance of the scalp from the outline in every frame, px."""
        return self._evaluate(poses)[2]

    def _evaluate(self, poses: RigidPoses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        starts = range(0, len(poses.rotations), CHUNK)
        parts = [self._evaluate_chunk(poses, slice(first, first + CHUNK)) for first in starts]
        information, gradient, distances = (np.concatenate(part) for part in zip(*parts, strict=True))
        return information, gradient, distances

    def _evaluate_chunk(self, poses: RigidPoses, chunk: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        here, intrinsics, scalp = poses[chunk], self.intrinsics, self.scalp
        points = here.to_camera(scalp.points[None])
        pixels, normals = project_to_pixels(points, intrinsics), scalp.normals @ here.rotations.transpose(0, 2, 1)
        in_plane = np.linalg.norm(normals[..., :2], axis=-1)
        rows = outline_vertices(pixels, here)
        frames = np.arange(len(rows))[:, None]
        pixels, in_plane, outward = pixels[frames, rows], in_plane[frames, rows], normals[frames, rows, :2]
        outward = outward / np.maximum(in_plane, 1e-9)[..., None]
        distances, valid = sample_distances(self.outline, chunk, pixels)
        deviation = OUTLINE_STD * self.face_width
        valid &= (in_plane > MINIMUM_IN_PLANE) & (rows >= 0)
        weights = robust_weights(distances[..., None], valid / deviation**2, 3.0)
        weights *= EFFECTIVE_OUTLINE_POINTS / np.maximum(valid.sum(axis=1, keepdims=True), EFFECTIVE_OUTLINE_POINTS)
        points = points[frames, rows]
        by_pose = pose_jacobian(points, here, projection_jacobian(points, intrinsics.focal))
        along = np.einsum("tvi,tvia->tva", outward, by_pose)
        weighted = along * weights[..., None]
        mean = (valid * distances**2).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
        information = weighted.transpose(0, 2, 1) @ along
        return information, np.einsum("tva,tv->ta", weighted, distances), np.sqrt(mean)


def outline_vertices(pixels: Float[np.ndarray, "T V 2"], poses: RigidPoses) -> Int[np.ndarray, "T D"]:
    """The vertex farthest from the scalp's center in every frame and direction; −1 where a direction holds none.

    Directions are counted from the head's own upright in the image.
    """
    arms = pixels - pixels.mean(axis=1, keepdims=True)
    upright = np.arctan2(poses.rotations[:, 0, 1], -poses.rotations[:, 1, 1])[:, None]
    angle = np.arctan2(arms[..., 0], -arms[..., 1]) - upright
    angle = (angle + np.pi) % (2 * np.pi) - np.pi
    direction = np.floor((angle + MAXIMUM_ANGLE) / (2 * MAXIMUM_ANGLE) * DIRECTIONS).astype(int)
    radius = np.linalg.norm(arms, axis=-1)
    result = np.full((len(pixels), DIRECTIONS), -1)
    for number in range(DIRECTIONS):
        radii = np.where(direction == number, radius, -1.0)
        farthest = radii.argmax(axis=1)
        result[:, number] = np.where(radii[np.arange(len(radii)), farthest] >= 0, farthest, -1)
    return result


def sample_distances(
    outline: OutlineDistances, frames: slice, pixels: Float[np.ndarray, "T V 2"]
) -> tuple[Float[np.ndarray, "T V"], Bool[np.ndarray, "T V"]]:
    """Signed distances to the outline at image positions, px, and whether they are in the image and not clipped."""
    maps = outline.distances[frames]
    values, _, within = bilinear(maps, np.arange(len(maps)), pixels * outline.scale)
    valid = within & (np.abs(values) < DISTANCE_STEPS * (MAXIMUM_DISTANCE - 1))
    return values / DISTANCE_STEPS / outline.scale, valid
