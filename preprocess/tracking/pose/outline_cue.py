"""Head poses that the hair agrees with.

Landmarks alone are misled where a grimace looks like a turn of the head; the outline of the scalp is not. Edges far
from the scalp (hair that moves by itself, things worn) hardly count.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int8, UInt8

from preprocess.tracking.geometry.bilinear import bilinear
from preprocess.tracking.geometry.rigid import (
    CHUNK,
    Lens,
    Poses,
    pose_slopes,
    project,
    projection_slopes,
    robust_weights,
)

WIDTH = 128
"""Masks are kept at this width, px."""
STEPS = 8
"""Kept distances are counted in such parts of a reduced pixel."""
FARTHEST = 16.0
"""Distances end here, reduced px; where they do, the outline is another thing's."""
DIRECTIONS = 36
"""The outline is the farthest vertex of the scalp in each of so many directions around its middle."""
UPPER = np.radians(100)
"""How far from upright these directions go: below is no hair's edge but the face's and the neck's."""
FLAT = 0.6
"""Least share of a normal that lies in the image, for its vertex to be on the outline."""
OUTLINE_ERROR = 0.010
"""Of the hair's edge, over the face's width."""
OUTLINE_COUNT = 12.0
"""As many independent places as the whole outline is worth."""


@dataclass(frozen=True)
class Edges:
    """Where every frame's outline is.

    Attributes:
        distances: Signed distance to it in 1/8 px of the reduced mask, positive inside, up to `FARTHEST`.
        scale: Of the reduced masks against the capture's images.
    """

    distances: Int8[np.ndarray, "T H W"]
    scale: float


def reduced_distances(mask: UInt8[np.ndarray, "H W"]) -> Int8[np.ndarray, "h w"]:
    """One frame's distances for `Edges`; the picture's own edge is no outline."""
    height = round(mask.shape[0] * WIDTH / mask.shape[1])
    inside = (cv2.resize(mask, (WIDTH, height), interpolation=cv2.INTER_AREA) > 127).astype(np.uint8)
    signed = cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)
    halfway = np.clip(signed, -FARTHEST, FARTHEST) - 0.5 * np.sign(signed)  # the edge lies between two pixels
    return np.round(STEPS * halfway).astype(np.int8)


@dataclass(frozen=True)
class Scalp:
    """Vertices of the scalp, m, and their unit normals, in head space."""

    points: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]


@dataclass(frozen=True)
class OutlineEvidence:
    """Where the outlines are, and the scalp that makes them.

    Attributes:
        edges: Outlines of the masks.
        scalp: The head's scalp.
        lens: Camera.
        width: Of the face in the image, px.
    """

    edges: Edges
    scalp: Scalp
    lens: Lens
    width: float

    def information(self, poses: Poses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Of every frame's pose."""
        information, gradient, _ = self._of_all(poses)
        return information, gradient

    def corrected(self, poses: Poses) -> OutlineEvidence:
        """The same: it takes its scalp for known."""
        return self

    def distances(self, poses: Poses) -> Float[np.ndarray, " T"]:
        """Root mean square distance of the scalp from the outline in every frame, px."""
        return self._of_all(poses)[2]

    def _of_all(self, poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        starts = range(0, len(poses.rotations), CHUNK)
        parts = [self._of_chunk(poses, slice(first, first + CHUNK)) for first in starts]
        information, gradient, distances = (np.concatenate(part) for part in zip(*parts, strict=True))
        return information, gradient, distances

    def _of_chunk(self, poses: Poses, chosen: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        here, lens, scalp = poses[chosen], self.lens, self.scalp
        seen = here.to_camera(scalp.points[None])
        pixels, normals = project(seen, lens), scalp.normals @ here.rotations.transpose(0, 2, 1)
        flat = np.linalg.norm(normals[..., :2], axis=-1)
        rows = farthest(pixels, here)
        frames = np.arange(len(rows))[:, None]
        pixels, flat, outward = pixels[frames, rows], flat[frames, rows], normals[frames, rows, :2]
        outward = outward / np.maximum(flat, 1e-9)[..., None]
        distances, known = sampled(self.edges, chosen, pixels)
        error = OUTLINE_ERROR * self.width
        known &= (flat > FLAT) & (rows >= 0)
        weights = robust_weights(distances[..., None], known / error**2, 3.0)
        weights *= OUTLINE_COUNT / np.maximum(known.sum(axis=1, keepdims=True), OUTLINE_COUNT)
        places = seen[frames, rows]
        slopes = pose_slopes(places, here, projection_slopes(places, lens.focal))
        along = np.einsum("tvi,tvia->tva", outward, slopes)
        weighted = along * weights[..., None]
        mean = (known * distances**2).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        information = weighted.transpose(0, 2, 1) @ along
        return information, np.einsum("tva,tv->ta", weighted, distances), np.sqrt(mean)


def farthest(pixels: Float[np.ndarray, "T V 2"], poses: Poses) -> np.ndarray:
    """For every frame and direction the vertex that lies farthest out; −1 where a direction holds none.

    Directions are counted from the head's own upright in the image.
    """
    arms = pixels - pixels.mean(axis=1, keepdims=True)
    upright = np.arctan2(poses.rotations[:, 0, 1], -poses.rotations[:, 1, 1])[:, None]
    angle = np.arctan2(arms[..., 0], -arms[..., 1]) - upright
    angle = (angle + np.pi) % (2 * np.pi) - np.pi
    direction = np.floor((angle + UPPER) / (2 * UPPER) * DIRECTIONS).astype(int)
    reach = np.linalg.norm(arms, axis=-1)
    result = np.full((len(pixels), DIRECTIONS), -1)
    for number in range(DIRECTIONS):
        there = np.where(direction == number, reach, -1.0)
        best = there.argmax(axis=1)
        result[:, number] = np.where(there[np.arange(len(there)), best] >= 0, best, -1)
    return result


def sampled(
    edges: Edges, chosen: slice, pixels: Float[np.ndarray, "T V 2"]
) -> tuple[Float[np.ndarray, "T V"], Bool[np.ndarray, "T V"]]:
    """Signed distances to the outline at image positions, px, and whether they are known (in the picture, and near)."""
    maps = edges.distances[chosen]
    values, _, within = bilinear(maps, np.arange(len(maps)), pixels * edges.scale)
    return values / STEPS / edges.scale, within & (np.abs(values) < STEPS * (FARTHEST - 1))
