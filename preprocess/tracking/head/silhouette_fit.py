"""Deforms scalp, ears, neck and shoulders so that the head's outline follows the masks; landmarks hold the face.

`vertex_normals` repeats that of `preprocess.synthetic.rendering.mesh`, which sums faces in another order and returns
single precision, so that tracking results would differ in the last bits.
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
from preprocess.tracking.geometry.projection import mask_iou, posed_vertices, project, silhouette
from preprocess.tracking.geometry.rigid import evenly_spaced
from preprocess.tracking.geometry.surface_extension import SurfaceExtension
from preprocess.tracking.head.generic_head import GenericHead

MASK_WIDTH = 192
"""Width to which masks are downscaled, px."""
MAXIMUM_FRAMES = 14
"""Frames whose masks are used."""
ROUNDS = 5
"""Alternations of outline displacements in every frame and their smooth extension."""
OUTLINE_TOLERANCE = 2.0
"""Distance to the mesh's outline within which a vertex is on it, px."""
MINIMUM_IN_PLANE = 0.6
"""Smallest length of a unit normal's part in the image plane for its vertex to be on the outline."""
STEP_GAIN = 0.7
"""Share of the distance to the mask's outline that a vertex moves in one round."""
MAXIMUM_STEP = 0.012
"""Largest displacement of a vertex in one round, m."""
DISPLACEMENT_LIMITS = {"scalp": 0.045, "neck": 0.012, "shoulders": 0.05, "torso": 0.07, "ears": 0.012}
"""Largest displacement of each region in total, m; `OTHER_LIMIT` for the rest."""
OTHER_LIMIT = 0.02
MAXIMUM_OUTLINE_DISTANCE = 0.06
"""An outline farther away is that of something else, m."""
OUTLINE_WEIGHT = 0.3
"""Weight of the outline against the smoothness of the displacement."""
PADDING = 96
"""Masks are replicated beyond the image's border by so many px, so that the border is no outline."""


@dataclass(frozen=True)
class OutlineMasks:
    """Downscaled masks of a few frames.

    Attributes:
        rows: Their frames.
        masks: 255 = person.
        scale: Size of the masks over that of the capture's images.
    """

    rows: Int[np.ndarray, " K"]
    masks: UInt8[np.ndarray, "K H W"]
    scale: float


def outline_frames(count: int) -> Int[np.ndarray, " K"]:
    """Evenly spaced frames whose masks are kept for `fit_silhouette`."""
    return evenly_spaced(count, MAXIMUM_FRAMES)


def downscaled_mask(mask: UInt8[np.ndarray, "H W"]) -> UInt8[np.ndarray, "h w"]:
    """A mask resized to `MASK_WIDTH`."""
    height = round(mask.shape[0] * MASK_WIDTH / mask.shape[1])
    return cv2.resize(mask, (MASK_WIDTH, height), interpolation=cv2.INTER_AREA)


def fit_silhouette(
    head: HeadModel, generic: GenericHead, tracking: Tracking, outlines: OutlineMasks
) -> Float[np.ndarray, "V 3"]:
    """The template with its outline fitted to the masks, m.

    Displacements are limited by region: hair in front of shoulders is neither shoulder nor neck.
    """
    connected = np.concatenate((generic.soft, _faces_of(generic, "torso")))
    outer = np.concatenate((connected, _faces_of(generic, "ears")))
    depths = [_inside_distance(mask) for mask in outlines.masks]
    first = head.template.numpy().astype(np.float64)
    template, limits = first.copy(), _limits(generic, len(first))
    for _ in range(ROUNDS):
        current = dataclasses.replace(head, template=torch.tensor(template, dtype=torch.float32))
        total, hits = np.zeros_like(template), np.zeros(len(template))
        per_frame = partial(_outline_displacements, (current, outer), tracking, outlines.scale)
        for rows, displacements in ordered_map(per_frame, zip(outlines.rows.tolist(), depths, strict=True)):
            total[rows] += displacements
            hits[rows] += 1
        wanted = np.clip(total / np.maximum(hits, 1)[:, None], -MAXIMUM_STEP, MAXIMUM_STEP)
        wanted[generic.regions["face"]] = 0.0
        weights = OUTLINE_WEIGHT * np.minimum(hits, 4) / 4
        weights[generic.regions["face"]] = 1.0
        weights[generic.regions["ears"]] = 0.0
        moved = template - first + _smooth_extension(connected, weights, wanted)
        for side in ("left_ear", "right_ear"):
            rows = generic.regions[side]
            outward = float(np.median(wanted[rows][hits[rows] > 0, 0])) if (hits[rows] > 0).any() else 0.0
            moved[rows] = template[rows] - first[rows] + np.array([outward, 0.0, 0.0])
        template = first + moved * np.minimum(1, limits / np.maximum(np.linalg.norm(moved, axis=1), 1e-9))[:, None]
    return template


def _limits(generic: GenericHead, count: int) -> Float[np.ndarray, " V"]:
    """Largest displacement of each vertex, m."""
    limits = np.full(count, OTHER_LIMIT)
    for name, limit in DISPLACEMENT_LIMITS.items():
        limits[generic.regions[name]] = limit
    return limits


def _smooth_extension(faces: np.ndarray, weights: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The smoothest displacement of all vertices near the wanted ones."""
    rows = np.flatnonzero(weights > 0)
    selection = csr_array((np.sqrt(weights[rows]), (np.arange(len(rows)), rows)), shape=(len(rows), len(weights)))
    extension = SurfaceExtension(faces, selection, np.full(len(weights), 1e-4))
    return extension(np.sqrt(weights[rows])[:, None] * wanted[rows])


def _faces_of(generic: GenericHead, region: str) -> np.ndarray:
    """Triangles with at least one corner in a region."""
    return generic.faces[np.isin(generic.faces, generic.regions[region]).any(axis=1)]


def _inside_distance(mask: np.ndarray) -> np.ndarray:
    """Signed distance to the mask's outline, positive inside, px; padded by `PADDING`."""
    wide = cv2.copyMakeBorder(mask, PADDING, PADDING, PADDING, PADDING, cv2.BORDER_REPLICATE)
    inside = (wide > 127).astype(np.uint8)
    return cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)


def _outline_displacements(
    surface: tuple[HeadModel, np.ndarray], tracking: Tracking, scale: float, view: tuple[int, np.ndarray]
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Vertices on the mesh's outline and their displacements (m) towards the outline of one frame's mask."""
    (head, faces), (row, depth) = surface, view
    height, width = depth.shape[0] - 2 * PADDING, depth.shape[1] - 2 * PADDING
    vertices = posed_vertices(head, tracking, row)
    pose = tracking.world_to_camera[row]
    pixels, distances = project(vertices, np.diag([scale, scale, 1.0]) @ tracking.intrinsics[row], pose)
    covered = silhouette(pixels + PADDING, distances, faces, (width + 2 * PADDING, height + 2 * PADDING))
    positions = np.floor(pixels + PADDING).astype(int)
    within = ((pixels > 1) & (pixels < [width - 1, height - 1])).all(axis=1)
    positions = np.clip(positions, 0, np.array(depth.shape[::-1]) - 1)
    to_edge = cv2.distanceTransform(covered.astype(np.uint8), cv2.DIST_L2, 5)[positions[:, 1], positions[:, 0]]
    normals = vertex_normals(vertices, faces) @ pose[:3, :3].T
    in_plane = np.linalg.norm(normals[:, :2], axis=1)
    rows = np.flatnonzero(within & (to_edge < OUTLINE_TOLERANCE) & (in_plane > MINIMUM_IN_PLANE))
    wanted = depth[positions[rows, 1], positions[rows, 0]] - to_edge[rows]
    outward = np.zeros((len(rows), 3))
    outward[:, :2] = normals[rows, :2] / in_plane[rows, None]
    meters = wanted * distances[rows] / (tracking.intrinsics[row, 0, 0] * scale)
    near = np.abs(meters) < MAXIMUM_OUTLINE_DISTANCE
    rows, meters, outward = rows[near], meters[near], outward[near]
    return rows, STEP_GAIN * meters[:, None] * outward @ pose[:3, :3]


def vertex_normals(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Unit normals, averaged over the faces around each vertex by area."""
    corners = vertices[faces]
    area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], area_vectors)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def silhouette_overlap(head: HeadModel, tracking: Tracking, outlines: OutlineMasks) -> float:
    """Mean intersection over union of the head's silhouette and the masks."""

    def score(view: tuple[int, np.ndarray]) -> float:
        row, mask = view
        vertices = posed_vertices(head, tracking, row)
        intrinsics = np.diag([outlines.scale, outlines.scale, 1.0]) @ tracking.intrinsics[row]
        pixels, distances = project(vertices, intrinsics, tracking.world_to_camera[row])
        return mask_iou(silhouette(pixels, distances, head.faces.numpy(), mask.shape[::-1]), mask > 127)

    return float(np.mean(list(ordered_map(score, zip(outlines.rows.tolist(), outlines.masks, strict=True)))))
