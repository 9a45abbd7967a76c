"""Head poses for which the skin keeps its look.

The landmark network hides a part of every nod: its points slide over the skin (docs/log.md). The skin's own texture
does not. Spots all over the rigid part of the face are compared with how they look in the clip as a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

from ggavatar.face.bundle import CanonicalFace
from preprocess.face_topology import LOWER_LIP_MARGIN, UPPER_LIP_MARGIN, lids, rigidity
from preprocess.in_order import in_order
from preprocess.rigid import Lens, Poses, pose_slopes, project, projection_slopes, robust_weights, spread_evenly
from preprocess.skin_pictures import SkinPictures

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
    """

    corners: Int[np.ndarray, "P 3"]
    weights: Float[np.ndarray, "P 3"]
    trust: Float[np.ndarray, " P"]


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
    return Spots(found, shares, (rigidity(face)[found] * shares).sum(axis=1))


def _spread(count: int) -> Float[np.ndarray, "K 3"]:
    """Barycentric coordinates of count·(count + 1) / 2 evenly spread places in a triangle."""
    first, second = (axis.ravel() for axis in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    chosen = first + second < count
    u, v = (first[chosen] + 1 / 3) / count, (second[chosen] + 1 / 3) / count
    return np.stack((1 - u - v, u, v), axis=1)


@dataclass(frozen=True)
class SkinEvidence:
    """How spots look in every frame, were the head posed like this.

    Attributes:
        pictures: Of the face.
        spots: Where to look.
        shapes: Landmarks in head space as the expressions of every frame put them, m.
        seen: Frames with a face.
        lens: Camera.
    """

    pictures: SkinPictures
    spots: Spots
    shapes: Float[np.ndarray, "T N 3"]
    seen: Bool[np.ndarray, " T"]
    lens: Lens

    def information(self, poses: Poses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Of every frame's pose; frames without a face tell nothing."""
        reference = self._reference(poses)
        return in_chunks(partial(self._chunk_information, poses, reference), np.arange(len(self.seen)))

    def _reference(self, poses: Poses) -> Float[np.ndarray, " P"]:
        """How the spots look in most of some frames."""
        seen = np.flatnonzero(self.seen)
        looks, visible = in_chunks(partial(self._looks, poses), seen[spread_evenly(len(seen), REFERENCE_FRAMES)])
        weights = visible
        for _ in range(REFERENCE_ROUNDS):
            reference = (weights * looks).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-6)
            weights = visible * _robust(looks - reference)
        return reference

    def _looks(self, poses: Poses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        places, visible = self._places(poses[frames], frames)
        looks, _, known = self.pictures.sampled(frames, project(places, self.lens))
        return looks, visible * known

    def _places(self, here: Poses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The spots in the camera, m, and how far they face it, in [0, 1]."""
        corners = self.shapes[frames][:, self.spots.corners]
        normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        places = here.to_camera(np.einsum("pc,tpcx->tpx", self.spots.weights, corners, optimize=True))
        normals = normals @ here.rotations.transpose(0, 2, 1)
        lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(places, axis=-1)
        facing = -(normals * places).sum(axis=-1) / np.maximum(lengths, 1e-12)
        return places, np.clip((facing - LEAST_FACING) / (FULLY_FACING - LEAST_FACING), 0.0, 1.0)

    def _chunk_information(
        self, poses: Poses, reference: np.ndarray, frames: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        here = poses[frames]
        places, visible = self._places(here, frames)
        looks, slopes, known = self.pictures.sampled(frames, project(places, self.lens))
        missed = reference - looks
        weights = visible * known * self.spots.trust * self.seen[frames, None] * _robust(missed)
        weights = weights * (SKIN_COUNT / len(reference))
        jacobian = np.matmul(slopes[:, :, None], pose_slopes(places, here, projection_slopes(places, self.lens.focal)))
        rows = jacobian[:, :, 0]
        weighted = rows * weights[..., None]
        return weighted.transpose(0, 2, 1) @ rows, np.einsum("tpa,tp->ta", weighted, missed)


def _robust(missed: Float[np.ndarray, "T P"]) -> Float[np.ndarray, "T P"]:
    """Inverse variances that shadows and wrinkles hardly have."""
    return robust_weights(missed[..., None], np.full(missed.shape, SKIN_ERROR**-2), 1.0)


def in_chunks(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], frames: Int[np.ndarray, " K"]
) -> tuple[np.ndarray, np.ndarray]:
    """What a function of a few frames says of many, by several threads."""
    parts = in_order(function, [frames[first : first + CHUNK] for first in range(0, len(frames), CHUNK)])
    first, second = (np.concatenate(part) for part in zip(*parts, strict=True))
    return first, second
