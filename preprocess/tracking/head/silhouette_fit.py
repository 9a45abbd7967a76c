"""Bending scalp, ears, neck and shoulders so that the head's outline follows the masks.

The face stays where the landmarks hold it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from scipy.sparse import csr_array

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from preprocess.tracking.geometry.projection import overlap, posed_vertices, project, silhouette
from preprocess.tracking.geometry.rigid import spread_evenly
from preprocess.tracking.geometry.surface_extension import SurfaceExtension
from preprocess.tracking.head.generic_head import GenericHead

WIDTH = 192
"""Masks are compared at this width, px."""
FRAMES = 14
ROUNDS = 5
NEAR_OUTLINE = 2.0
"""A vertex is on the outline if it lies within so many px of it."""
LARGEST_STEP = 0.012
"""Largest move of a vertex in one round, m."""
LIMITS = {"scalp": 0.045, "neck": 0.012, "shoulders": 0.05, "torso": 0.07, "ears": 0.012}
"""Farthest that parts may move altogether, m; others a little."""
FARTHEST = 0.06
"""An outline farther away than this is another thing's, m."""
PULL = 0.3
"""Weight of the outline's pull against the smoothness of the displacement."""
PADDING = 96
"""Masks go on beyond the picture for so many px, as they are at its edge: the picture's edge is no outline."""


@dataclass(frozen=True)
class Outlines:
    """Masks of a few frames, reduced.

    Attributes:
        rows: Which frames.
        masks: 255 = person.
        scale: Of the masks against the capture's images.
    """

    rows: Int[np.ndarray, " K"]
    masks: UInt8[np.ndarray, "K H W"]
    scale: float


def chosen_rows(count: int) -> Int[np.ndarray, " K"]:
    """Evenly spread frames whose masks are worth keeping."""
    return spread_evenly(count, FRAMES)


def reduce_mask(mask: UInt8[np.ndarray, "H W"]) -> UInt8[np.ndarray, "h w"]:
    """A mask at the width used here."""
    height = round(mask.shape[0] * WIDTH / mask.shape[1])
    return cv2.resize(mask, (WIDTH, height), interpolation=cv2.INTER_AREA)


def fit_outline(
    head: HeadModel, generic: GenericHead, tracking: Tracking, outlines: Outlines
) -> Float[np.ndarray, "V 3"]:
    """The template with its outline on the masks', m.

    How far parts may move is bounded: hair over shoulders is neither shoulder nor neck.
    """
    connected = np.concatenate((generic.soft, _faces_of(generic, "torso")))
    outer = np.concatenate((connected, _faces_of(generic, "ears")))
    depths = [_inside_distance(mask) for mask in outlines.masks]
    first = head.template.numpy().astype(np.float64)
    template, limits = first.copy(), _limits(generic, len(first))
    for _ in range(ROUNDS):
        current = dataclasses.replace(head, template=torch.tensor(template, dtype=torch.float32))
        total, hits = np.zeros_like(template), np.zeros(len(template))
        pulled = partial(_pulls, (current, outer), tracking, outlines.scale)
        for rows, pulls in ordered_map(pulled, zip(outlines.rows.tolist(), depths, strict=True)):
            total[rows] += pulls
            hits[rows] += 1
        wanted = np.clip(total / np.maximum(hits, 1)[:, None], -LARGEST_STEP, LARGEST_STEP)
        wanted[generic.regions["face"]] = 0.0
        weights = PULL * np.minimum(hits, 4) / 4
        weights[generic.regions["face"]] = 1.0
        weights[generic.regions["ears"]] = 0.0
        moved = template - first + _spread(connected, weights, wanted)
        for side in ("left_ear", "right_ear"):
            rows = generic.regions[side]
            outward = float(np.median(wanted[rows][hits[rows] > 0, 0])) if (hits[rows] > 0).any() else 0.0
            moved[rows] = template[rows] - first[rows] + np.array([outward, 0.0, 0.0])
        template = first + moved * np.minimum(1, limits / np.maximum(np.linalg.norm(moved, axis=1), 1e-9))[:, None]
    return template


def _limits(generic: GenericHead, count: int) -> Float[np.ndarray, " V"]:
    """Farthest that each vertex may move, m."""
    limits = np.full(count, 0.02)
    for name, limit in LIMITS.items():
        limits[generic.regions[name]] = limit
    return limits


def _spread(faces: np.ndarray, weights: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The smoothest displacement near the wanted ones."""
    rows = np.flatnonzero(weights > 0)
    pulls = csr_array((np.sqrt(weights[rows]), (np.arange(len(rows)), rows)), shape=(len(rows), len(weights)))
    extension = SurfaceExtension(faces, pulls, np.full(len(weights), 1e-4))
    return extension(np.sqrt(weights[rows])[:, None] * moved[rows])


def _faces_of(generic: GenericHead, region: str) -> np.ndarray:
    """Triangles with a corner in a region."""
    return generic.faces[np.isin(generic.faces, generic.regions[region]).any(axis=1)]


def _inside_distance(mask: np.ndarray) -> np.ndarray:
    """Distance to the mask's outline, positive inside, px; continued beyond the picture."""
    wide = cv2.copyMakeBorder(mask, PADDING, PADDING, PADDING, PADDING, cv2.BORDER_REPLICATE)
    inside = (wide > 127).astype(np.uint8)
    return cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)


def _pulls(
    surface: tuple[HeadModel, np.ndarray], tracking: Tracking, scale: float, view: tuple[int, np.ndarray]
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Vertices on the mesh's outline and the displacements, m, that one frame's mask asks for."""
    (head, faces), (row, depth) = surface, view
    height, width = depth.shape[0] - 2 * PADDING, depth.shape[1] - 2 * PADDING
    vertices = posed_vertices(head, tracking, row)
    pose = tracking.world_to_camera[row]
    pixels, distances = project(vertices, np.diag([scale, scale, 1.0]) @ tracking.intrinsics[row], pose)
    covered = silhouette(pixels + PADDING, distances, faces, (width + 2 * PADDING, height + 2 * PADDING))
    places = np.floor(pixels + PADDING).astype(int)
    within = ((pixels > 1) & (pixels < [width - 1, height - 1])).all(axis=1)
    places = np.clip(places, 0, np.array(depth.shape[::-1]) - 1)
    to_edge = cv2.distanceTransform(covered.astype(np.uint8), cv2.DIST_L2, 5)[places[:, 1], places[:, 0]]
    normals = vertex_normals(vertices, faces) @ pose[:3, :3].T
    flat = np.linalg.norm(normals[:, :2], axis=1)
    rows = np.flatnonzero(within & (to_edge < NEAR_OUTLINE) & (flat > 0.6))
    wanted = depth[places[rows, 1], places[rows, 0]] - to_edge[rows]
    outward = np.zeros((len(rows), 3))
    outward[:, :2] = normals[rows, :2] / flat[rows, None]
    metres = wanted * distances[rows] / (tracking.intrinsics[row, 0, 0] * scale)
    near = np.abs(metres) < FARTHEST
    rows, metres, outward = rows[near], metres[near], outward[near]
    return rows, 0.7 * metres[:, None] * outward @ pose[:3, :3]


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], areas)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def outline_overlap(head: HeadModel, tracking: Tracking, outlines: Outlines) -> float:
    """Mean intersection over union of mesh and masks."""

    def score(view: tuple[int, np.ndarray]) -> float:
        row, mask = view
        vertices = posed_vertices(head, tracking, row)
        intrinsics = np.diag([outlines.scale, outlines.scale, 1.0]) @ tracking.intrinsics[row]
        pixels, distances = project(vertices, intrinsics, tracking.world_to_camera[row])
        return overlap(silhouette(pixels, distances, head.faces.numpy(), mask.shape[::-1]), mask > 127)

    return float(np.mean(list(ordered_map(score, zip(outlines.rows.tolist(), outlines.masks, strict=True)))))
