"""Pose cue: photometric consistency of facial skin.

The landmark network's points slide over the skin when the head nods; the skin's own texture does not. Patches all over
the rigid part of the face are compared with their mean intensity over the clip. Measured in
docs/experiments/2026-11-29-skin-texture-pose-cue.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry.landmark_topology import LOWER_LIP_MARGIN, UPPER_LIP_MARGIN, lids, rigidity
from preprocess.tracking.geometry.rigid import (
    PinholeIntrinsics,
    RigidPoses,
    evenly_spaced,
    pose_jacobian,
    project_to_pixels,
    projection_jacobian,
    robust_weights,
)
from preprocess.tracking.pose.bundle_adjustment import ShapePrior
from preprocess.tracking.pose.texture_images import SkinImages

CHUNK = 50
"""Frames that one thread processes at a time."""
PATCH_SPACING = 0.012
"""Distance between neighboring patches, m."""
MAXIMUM_EDGE = 0.04
"""Triangles with a longer edge span what is not skin, m."""
INTENSITY_STD = 0.5
"""Standard deviation of a patch's intensity, in units of the local contrast."""
EFFECTIVE_PATCHES = 600.0
"""Effective number of independent patches among all of them."""
MINIMUM_FACING, FULL_FACING = 0.3, 0.6
"""Cosine between a patch's normal and the view above which it counts, and above which it has full weight."""
REFERENCE_FRAMES = 100
"""Frames from which reference intensities and depths are estimated."""
REFERENCE_ROUNDS = 3
"""Reweighted averages from which a reference intensity is found."""


@dataclass(frozen=True)
class SkinPatches:
    """Points on the face's triangles at which the skin's texture is sampled.

    Attributes:
        corners: Landmarks at the corners of each patch's triangle, counterclockwise seen from outside.
        weights: Barycentric weights of each patch in its triangle.
        rigidity: Weight of each patch as a point fixed to the skull.
        modes: Offset in depth per unit of a coefficient with standard normal prior, m.
    """

    corners: Int[np.ndarray, "P 3"]
    weights: Float[np.ndarray, "P 3"]
    rigidity: Float[np.ndarray, " P"]
    modes: Float[np.ndarray, "P M"]


def skin_patches(face: CanonicalFace) -> SkinPatches:
    """Patches about `PATCH_SPACING` apart all over the face except for the eyes, which rotate, and the mouth."""
    triangles = Delaunay(face.vertices[:, :2]).simplices.astype(np.int64)
    sides = face.vertices[triangles] - face.vertices[np.roll(triangles, -1, axis=1)]
    longest = np.linalg.norm(sides, axis=-1).max(axis=1)
    holes = [np.isin(triangles, margin).all(axis=1) for margin in (lids(), (*UPPER_LIP_MARGIN, *LOWER_LIP_MARGIN))]
    kept = (longest < MAXIMUM_EDGE) & ~holes[0] & ~holes[1]
    corners, weights = [], []
    for triangle, length in zip(triangles[kept], longest[kept], strict=True):
        inside = _barycentric_grid(max(1, int(np.ceil(length / PATCH_SPACING))))
        corners.append(np.tile(triangle, (len(inside), 1)))
        weights.append(inside)
    all_corners, all_weights = np.concatenate(corners), np.concatenate(weights)
    modes = np.einsum("pcm,pc->pm", ShapePrior.from_canonical(face.vertices).modes[all_corners], all_weights)
    return SkinPatches(all_corners, all_weights, (rigidity(face)[all_corners] * all_weights).sum(axis=1), modes)


def _barycentric_grid(count: int) -> Float[np.ndarray, "K 3"]:
    """Barycentric coordinates of count·(count + 1) / 2 evenly spaced points in a triangle."""
    first, second = (axis.ravel() for axis in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    chosen = first + second < count
    u, v = (first[chosen] + 1 / 3) / count, (second[chosen] + 1 / 3) / count
    return np.stack((1 - u - v, u, v), axis=1)


@dataclass(frozen=True)
class TextureCue:
    """Intensities of skin patches in every frame against their reference.

    The visible surface need not be where landmarks put the skin: glasses and brows stand in front of it, and landmarks
    at the face's edge slide. So patches have a depth of their own, estimated from their parallax when the head rotates.

    Attributes:
        images: Skin images of all frames.
        patches: Where they are sampled.
        shapes: Landmarks in head space under the expression of every frame, m.
        found: Frames with a face.
        intrinsics: Of the camera.
        depths: Offset of the patches in front of the landmarks' surface along the head's z axis, as coefficients of
            `SkinPatches.modes`; None before they are estimated.
        reference: Mean intensity of the patches over the clip; None before it is estimated.
    """

    images: SkinImages
    patches: SkinPatches
    shapes: Float[np.ndarray, "T N 3"]
    found: Bool[np.ndarray, " T"]
    intrinsics: PinholeIntrinsics
    depths: Float[np.ndarray, " M"] | None = None
    reference: Float[np.ndarray, " P"] | None = None

    def information(self, poses: RigidPoses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Information matrix and gradient of every frame's pose; zero in frames without a face."""
        cue = self if self.reference is not None else self.refined(poses)
        information, gradient = cue._in_chunks(cue._pose_information, poses, np.arange(len(self.found)))
        return information, gradient

    def refined(self, poses: RigidPoses) -> TextureCue:
        """The cue with reference intensities and depths of the patches re-estimated, given these poses."""
        found, modes = np.flatnonzero(self.found), self.patches.modes
        frames = found[evenly_spaced(len(found), REFERENCE_FRAMES)]
        intensities, weights, by_depth = self._in_chunks(self._intensities, poses, frames)
        reference = robust_mean(intensities, weights)
        residuals = reference - intensities
        weights = weights * _robust_precision(residuals) * (len(found) / len(frames))
        depths = np.zeros(modes.shape[1]) if self.depths is None else self.depths
        normal = (modes.T * (weights * by_depth**2).sum(axis=0)) @ modes + np.eye(len(depths))
        vector = modes.T @ (weights * by_depth * residuals).sum(axis=0) - depths
        return replace(self, depths=depths + np.linalg.solve(normal, vector), reference=reference)

    def _intensities(self, poses: RigidPoses, frames: np.ndarray) -> tuple[np.ndarray, ...]:
        """Intensities of the patches in some frames, their weights, and their derivatives in depth, 1/m."""
        here = poses[frames]
        points, intensities, gradients, weights = self._sample(here, frames)
        by_depth = np.matmul(projection_jacobian(points, self.intrinsics.focal), here.rotations[:, None, :, 2:])[..., 0]
        return intensities, weights, (gradients * by_depth).sum(axis=-1)

    def _pose_information(self, poses: RigidPoses, frames: np.ndarray) -> tuple[np.ndarray, ...]:
        here = poses[frames]
        points, intensities, gradients, weights = self._sample(here, frames)
        residuals = self.reference - intensities
        weights = weights * _robust_precision(residuals) * self.found[frames, None]
        by_pose = pose_jacobian(points, here, projection_jacobian(points, self.intrinsics.focal))
        rows = np.matmul(gradients[:, :, None], by_pose)[:, :, 0]
        weighted = rows * weights[..., None]
        return weighted.transpose(0, 2, 1) @ rows, np.einsum("tpa,tp->ta", weighted, residuals)

    def _sample(self, here: RigidPoses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Camera-space positions of the patches, m, their intensities, image gradients (1/px) and weights."""
        points, facing = self._positions(here, frames)
        intensities, gradients, within = self.images.sample(frames, project_to_pixels(points, self.intrinsics))
        visible = np.clip((facing - MINIMUM_FACING) / (FULL_FACING - MINIMUM_FACING), 0.0, 1.0)
        share = EFFECTIVE_PATCHES / len(self.patches.rigidity)
        return points, intensities, gradients, visible * within * self.patches.rigidity * share

    def _positions(self, here: RigidPoses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Camera-space positions of the patches, m, and the cosine between their normals and the view."""
        corners = self.shapes[frames][:, self.patches.corners]
        normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        surface = np.einsum("pc,tpcx->tpx", self.patches.weights, corners, optimize=True)
        if self.depths is not None:
            surface[..., 2] += self.patches.modes @ self.depths
        points = here.to_camera(surface)
        normals = normals @ here.rotations.transpose(0, 2, 1)
        lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(points, axis=-1)
        return points, -(normals * points).sum(axis=-1) / np.maximum(lengths, 1e-12)

    def _in_chunks(
        self,
        function: Callable[[RigidPoses, np.ndarray], tuple[np.ndarray, ...]],
        poses: RigidPoses,
        frames: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """The results of a function of poses and frames, computed in chunks on several threads and concatenated."""
        chunks = [frames[first : first + CHUNK] for first in range(0, len(frames), CHUNK)]
        parts = ordered_map(partial(function, poses), chunks)
        return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def robust_mean(intensities: Float[np.ndarray, "T P"], weights: Float[np.ndarray, "T P"]) -> Float[np.ndarray, " P"]:
    """Mean intensity of every patch over the frames, robust to outliers (iteratively reweighted)."""
    reweighted = weights
    for _ in range(REFERENCE_ROUNDS):
        mean = (reweighted * intensities).sum(axis=0) / np.maximum(reweighted.sum(axis=0), 1e-9)
        reweighted = weights * _robust_precision(intensities - mean)
    return mean


def _robust_precision(residuals: Float[np.ndarray, "T P"]) -> Float[np.ndarray, "T P"]:
    """Inverse variances of intensities, small where shadows and wrinkles make outliers."""
    return robust_weights(residuals[..., None], np.full(residuals.shape, INTENSITY_STD**-2), 1.0)
