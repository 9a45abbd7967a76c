"""Pose cue: photometric consistency of facial skin.

The landmark network's points slide over the skin when the head nods; the skin's own texture does not. Patches all over
the rigid part of the face are compared with their average appearance over the clip. Measured in
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
    Lens,
    Poses,
    pose_slopes,
    project,
    projection_slopes,
    robust_weights,
    spread_evenly,
)
from preprocess.tracking.pose.bundle_adjustment import ShapePrior
from preprocess.tracking.pose.texture_images import SkinPictures

CHUNK = 50
SPACING = 0.012
"""Distance between spots, m."""
LONGEST_EDGE = 0.04
"""Triangles with a longer edge span what is no skin, m."""
SKIN_ERROR = 0.5
"""Of a spot's look, in units of its surroundings' contrast."""
SKIN_COUNT = 600.0
"""As many independent spots as all of them are worth."""
LEAST_FACING, FULLY_FACING = 0.3, 0.6
"""Cosine between a spot's normal and the view from which it counts, and from which it counts in full."""
REFERENCE_FRAMES = 100
REFERENCE_ROUNDS = 3


@dataclass(frozen=True)
class Spots:
    """Places on the face's triangles.

    Attributes:
        corners: Landmarks at the corners of each spot's triangle, counterclockwise from outside.
        weights: Barycentric.
        trust: That the spot is fixed to the skull.
        modes: Offsets in depth per unit of a coefficient with standard normal prior, m.
    """

    corners: Int[np.ndarray, "P 3"]
    weights: Float[np.ndarray, "P 3"]
    trust: Float[np.ndarray, " P"]
    modes: Float[np.ndarray, "P M"]


def face_spots(face: CanonicalFace) -> Spots:
    """Spots about `SPACING` apart all over the face but for the eyes, which turn, and the mouth, which opens."""
    triangles = Delaunay(face.vertices[:, :2]).simplices.astype(np.int64)
    sides = face.vertices[triangles] - face.vertices[np.roll(triangles, -1, axis=1)]
    longest = np.linalg.norm(sides, axis=-1).max(axis=1)
    holes = [np.isin(triangles, margin).all(axis=1) for margin in (lids(), (*UPPER_LIP_MARGIN, *LOWER_LIP_MARGIN))]
    kept = (longest < LONGEST_EDGE) & ~holes[0] & ~holes[1]
    corners, weights = [], []
    for triangle, length in zip(triangles[kept], longest[kept], strict=True):
        inside = _spread(max(1, int(np.ceil(length / SPACING))))
        corners.append(np.tile(triangle, (len(inside), 1)))
        weights.append(inside)
    found, shares = np.concatenate(corners), np.concatenate(weights)
    modes = np.einsum("pcm,pc->pm", ShapePrior.around(face.vertices).modes[found], shares)
    return Spots(found, shares, (rigidity(face)[found] * shares).sum(axis=1), modes)


def _spread(count: int) -> Float[np.ndarray, "K 3"]:
    """Barycentric coordinates of count·(count + 1) / 2 evenly spread places in a triangle."""
    first, second = (axis.ravel() for axis in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    chosen = first + second < count
    u, v = (first[chosen] + 1 / 3) / count, (second[chosen] + 1 / 3) / count
    return np.stack((1 - u - v, u, v), axis=1)


@dataclass(frozen=True)
class SkinEvidence:
    """How spots look in every frame, were the head posed like this.

    What is seen there need not lie where landmarks put the skin: glasses and brows stand before it, and landmarks of
    the face's edge slide. So spots have a depth of their own, learnt from how they move when the head turns.

    Attributes:
        pictures: Of the face.
        spots: Where to look.
        shapes: Landmarks in head space as the expressions of every frame put them, m.
        seen: Frames with a face.
        lens: Camera.
        depths: How far in front of the landmarks' surface spots lie along the head's z axis, as coefficients of
            `Spots.modes`; None before they are learnt.
        reference: How spots look in the clip as a whole; None before it is learnt.
    """

    pictures: SkinPictures
    spots: Spots
    shapes: Float[np.ndarray, "T N 3"]
    seen: Bool[np.ndarray, " T"]
    lens: Lens
    depths: Float[np.ndarray, " M"] | None = None
    reference: Float[np.ndarray, " P"] | None = None

    def information(self, poses: Poses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Of every frame's pose; frames without a face tell nothing."""
        known = self if self.reference is not None else self.corrected(poses)
        information, gradient = known._in_chunks(known._pose_information, poses, np.arange(len(self.seen)))
        return information, gradient

    def corrected(self, poses: Poses) -> SkinEvidence:
        """With the looks and depths of the spots as they would be, were the poses these."""
        seen, modes = np.flatnonzero(self.seen), self.spots.modes
        chosen = seen[spread_evenly(len(seen), REFERENCE_FRAMES)]
        looks, weights, by_depth = self._in_chunks(self._looks, poses, chosen)
        reference = usual(looks, weights)
        missed = reference - looks
        weights = weights * _robust(missed) * (len(seen) / len(chosen))
        depths = np.zeros(modes.shape[1]) if self.depths is None else self.depths
        normal = (modes.T * (weights * by_depth**2).sum(axis=0)) @ modes + np.eye(len(depths))
        vector = modes.T @ (weights * by_depth * missed).sum(axis=0) - depths
        return replace(self, depths=depths + np.linalg.solve(normal, vector), reference=reference)

    def _looks(self, poses: Poses, frames: np.ndarray) -> tuple[np.ndarray, ...]:
        """Of the spots in some frames, their weights, and how looks change with depth, 1/m."""
        here = poses[frames]
        places, looks, slopes, weights = self._glance(here, frames)
        by_depth = np.matmul(projection_slopes(places, self.lens.focal), here.rotations[:, None, :, 2:])[..., 0]
        return looks, weights, (slopes * by_depth).sum(axis=-1)

    def _pose_information(self, poses: Poses, frames: np.ndarray) -> tuple[np.ndarray, ...]:
        here = poses[frames]
        places, looks, slopes, weights = self._glance(here, frames)
        missed = self.reference - looks
        weights = weights * _robust(missed) * self.seen[frames, None]
        jacobian = np.matmul(slopes[:, :, None], pose_slopes(places, here, projection_slopes(places, self.lens.focal)))
        rows = jacobian[:, :, 0]
        weighted = rows * weights[..., None]
        return weighted.transpose(0, 2, 1) @ rows, np.einsum("tpa,tp->ta", weighted, missed)

    def _glance(self, here: Poses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The spots in the camera, m, their looks, how these change per px, and how much each spot counts."""
        places, facing = self._places(here, frames)
        looks, slopes, known = self.pictures.sampled(frames, project(places, self.lens))
        visible = np.clip((facing - LEAST_FACING) / (FULLY_FACING - LEAST_FACING), 0.0, 1.0)
        return places, looks, slopes, visible * known * self.spots.trust * (SKIN_COUNT / len(self.spots.trust))

    def _places(self, here: Poses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The spots in the camera, m, and the cosine between their normals and the view."""
        corners = self.shapes[frames][:, self.spots.corners]
        normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        surface = np.einsum("pc,tpcx->tpx", self.spots.weights, corners, optimize=True)
        if self.depths is not None:
            surface[..., 2] += self.spots.modes @ self.depths
        places = here.to_camera(surface)
        normals = normals @ here.rotations.transpose(0, 2, 1)
        lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(places, axis=-1)
        return places, -(normals * places).sum(axis=-1) / np.maximum(lengths, 1e-12)

    def _in_chunks(
        self, function: Callable[[Poses, np.ndarray], tuple[np.ndarray, ...]], poses: Poses, frames: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """What a function of a few frames says of many, by several threads."""
        chunks = [frames[first : first + CHUNK] for first in range(0, len(frames), CHUNK)]
        parts = ordered_map(partial(function, poses), chunks)
        return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def usual(looks: Float[np.ndarray, "T P"], weights: Float[np.ndarray, "T P"]) -> Float[np.ndarray, " P"]:
    """How spots look in most frames."""
    trusted = weights
    for _ in range(REFERENCE_ROUNDS):
        reference = (trusted * looks).sum(axis=0) / np.maximum(trusted.sum(axis=0), 1e-9)
        trusted = weights * _robust(looks - reference)
    return reference


def _robust(missed: Float[np.ndarray, "T P"]) -> Float[np.ndarray, "T P"]:
    """Inverse variances that shadows and wrinkles hardly have."""
    return robust_weights(missed[..., None], np.full(missed.shape, SKIN_ERROR**-2), 1.0)
