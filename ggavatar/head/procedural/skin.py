"""Triangulation of the procedural head's skin: edge loops around eyes and mouth, graded Poisson-disk points elsewhere.

Vertices are directions on the parameter sphere of `surface.cast_rays`. The convex hull of points on a sphere is their
Delaunay triangulation, without seams or poles. Only the left half is sampled; the right half is its mirror image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import coo_array
from scipy.spatial import ConvexHull, cKDTree

from ggavatar.head.procedural.surface import HEAD_CENTER, LOWEST, cast_rays, skin_distance

INNER_CANTHUS, OUTER_CANTHUS = (0.0175, 0.0222), (0.0436, 0.0246)
UPPER_LID_RISE, LOWER_LID_FALL = 0.0064, 0.0050
MOUTH_HALF_WIDTH = 0.0250
EYE_POINTS, LIP_POINTS = 32, 44
_EYE_RINGS = (0.0, 0.0012, 0.0029, 0.0050, 0.0078, 0.0115)
_LIP_RINGS = (0.0, 0.0018, 0.0039, 0.0062, 0.0090, 0.0128)
_LIP_GAP = 0.0009


@dataclass(frozen=True)
class Skin:
    """The outer skin.

    Attributes:
        vertices: Positions, m.
        faces: Counter-clockwise from outside.
        left_lids: Loop of the left lid margin, from the outer corner along the upper lid and back along the lower one.
        right_lids: The same for the right eye, from its outer corner.
        lips: Loop of the lip margin, from the left corner along the upper lip, then back along the lower lip.
        rim: Loop of the lower edge of the shoulders, unordered.
    """

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    left_lids: Int[ndarray, " E"]
    right_lids: Int[ndarray, " E"]
    lips: Int[ndarray, " M"]
    rim: Int[ndarray, " R"]


def lip_line_height(x: Float[ndarray, " N"]) -> Float[ndarray, " N"]:
    """Height of the line between the closed lips at `x`, m."""
    across = np.abs(x) / MOUTH_HALF_WIDTH
    return -0.0463 - 0.0006 * np.clip(across, 0, 1.5) ** 2 - 0.0004 * np.exp(-((across / 0.18) ** 2))


def lid_curve(count: int = EYE_POINTS) -> Float[ndarray, "N 2"]:
    """Outline of the left eye's opening seen from the front, from the outer corner along the upper lid, m."""
    angle = np.arange(count) * 2 * np.pi / count
    inner, outer = np.asarray(INNER_CANTHUS), np.asarray(OUTER_CANTHUS)
    across = 0.5 + 0.5 * np.cos(angle)
    line = inner + across[:, None] * (outer - inner)
    upper = np.sin(angle) > 0
    lean = np.sin(angle) * (1 + np.where(upper, -0.16, 0.14) * np.cos(angle))
    height = np.where(upper, UPPER_LID_RISE * np.abs(lean) ** 0.85, -LOWER_LID_FALL * np.abs(lean) ** 0.9)
    return line + np.stack((np.zeros(count), np.where(np.abs(np.sin(angle)) < 1e-9, 0.0, height)), axis=1)


def build_skin(seed: int = 0) -> Skin:
    """Triangulate the surface of `HEAD_PRIMITIVES`; the seed decides the result."""
    eye, lips, holes = _rings()
    left = np.concatenate((*eye, *(ring[ring[:, 0] > 1e-6] for ring in lips)))
    middle = np.concatenate([ring[np.abs(ring[:, 0]) <= 1e-6] for ring in lips])
    filled, filled_middle = _fill(np.concatenate((left, middle)), holes, np.random.default_rng(seed))
    half = np.concatenate((left, filled))
    directions = np.concatenate((half, half * (-1, 1, 1), middle, filled_middle))
    loops = _loops(directions, eye[0], lips[0])
    rim = np.flatnonzero(directions[:, 1] < -np.sin(LOWEST - 1e-6))
    faces = _triangulate(directions)
    for hole in (rim, *loops):
        faces = faces[~np.isin(faces, hole).all(axis=1)]
    pinned = np.concatenate((left, left * (-1, 1, 1), middle, directions[rim]))
    movable = np.asarray(cKDTree(pinned).query(directions)[0] > 1e-9)
    vertices = _close_lips(cast_rays(directions), loops[2])
    return Skin(_relax(vertices, faces, movable), faces, *loops, rim)


def _rings() -> tuple[list[ndarray], list[ndarray], tuple[ndarray, ndarray]]:
    """Directions of the loops around the left eye and the mouth, and the outermost loop of each in the front view."""
    eye, lips = (
        _offset_rings(lid_curve(), _EYE_RINGS, _eye_ring_factor),
        _offset_rings(_lip_curve(), _LIP_RINGS, _lip_ring_factor),
    )
    ends = np.cumsum([len(ring) for ring in (*eye, *lips)])[:-1]
    rings = np.split(_at_front(np.concatenate((*eye, *lips))), ends)
    return rings[: len(eye)], rings[len(eye) :], (eye[-1], lips[-1])


def _lip_curve() -> ndarray:
    """The gap between the lips as a thin convex lens, from the left corner along the upper lip."""
    angle = np.arange(LIP_POINTS) * 2 * np.pi / LIP_POINTS
    return np.stack((MOUTH_HALF_WIDTH * np.cos(angle), -0.0466 + _LIP_GAP * np.sin(angle)), axis=1)


def _offset_rings(
    curve: ndarray, distances: tuple[float, ...], factor: Callable[[ndarray, float], ndarray]
) -> list[ndarray]:
    """Loops at growing distances outside a closed curve; `factor(normals, distance)` scales the distance per point."""
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    normal = np.stack((tangent[:, 1], -tangent[:, 0]), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return [curve + distance * factor(normal, distance) * normal for distance in distances]


def _eye_ring_factor(normal: ndarray, distance: float) -> ndarray:
    """Rings stay narrow towards the nose."""
    return (1 - 0.45 * np.clip(-normal[:, 0], 0, 1) * (distance / _EYE_RINGS[-1]))[:, None]


def _lip_ring_factor(normal: ndarray, distance: float) -> ndarray:
    """Rings stay narrow at the corners and below the nose."""
    return (1 - 0.25 * np.abs(normal[:, 0]) - 0.12 * np.clip(normal[:, 1], 0, 1) * (distance / _LIP_RINGS[-1]))[:, None]


def _at_front(points: ndarray) -> ndarray:
    """Directions whose skin points have the given x and y on the front of the face."""
    depth = np.full(len(points), 0.04)
    for _ in range(4):
        direction = np.column_stack((points, depth)) - HEAD_CENTER
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        depth = cast_rays(direction)[:, 2]
    return direction


def target_spacing(points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
    """Target distance between neighboring vertices, m: small at nose, eyes and mouth, large on scalp and shoulders."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    size = np.interp(z, [-0.06, -0.01, 0.025], [0.0115, 0.0090, 0.0062])
    size = np.maximum(size, np.interp(y, [0.055, 0.10], [0.0, 0.0095]))
    size = np.maximum(size, np.interp(-y, [0.10, 0.13], [0.0, 0.0095]))
    for center, reach, fine in _FINE_REGIONS:
        near = np.exp(-(((x - center[0]) / reach[0]) ** 2 + ((y - center[1]) / reach[1]) ** 2)) * (z > 0.01)
        size = size + (fine - size) * np.where(fine < size, near, 0.0)
    return 0.8 * size


_FINE_REGIONS = (
    ((0.006, -0.018), (0.018, 0.014), 0.0030),
    ((0.0, 0.010), (0.014, 0.020), 0.0042),
    ((0.031, 0.024), (0.026, 0.022), 0.0040),
    ((0.0, -0.048), (0.036, 0.024), 0.0042),
    ((0.024, -0.015), (0.016, 0.020), 0.0052),
)


def _fill(fixed: ndarray, holes: tuple[ndarray, ...], generator: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Blue-noise directions on the left half and on the midline, at the target spacing and outside `holes`."""
    lookup = _coarse_lookup()
    ring = np.linspace(-np.pi, np.pi, 65)[32:64] + np.pi / 128
    middle = _middle_line(lookup)
    rim = _direction(np.full(32, -LOWEST), ring)
    elevation = np.concatenate(
        (np.arcsin(generator.uniform(-1, 1, 30000)), -generator.uniform(0.9, LOWEST - 0.004, 14000))
    )
    heading = generator.uniform(0, np.pi, len(elevation))
    candidates = _direction(elevation, heading)[elevation > -LOWEST]
    position = lookup(candidates)
    wanted = target_spacing(position)
    outside = ~np.any([_inside(position, hole) for hole in holes], axis=0)
    candidates = candidates[(position[:, 0] > 0.45 * wanted) & outside]
    kept = _poisson_disk(lookup, candidates, np.concatenate((fixed, rim, middle)), generator)
    middle = middle[~np.any([_inside(lookup(middle), hole) for hole in holes], axis=0)]
    middle = middle[cKDTree(cast_rays(fixed)).query(lookup(middle))[0] > 0.75 * target_spacing(lookup(middle))]
    return np.concatenate((rim, kept)), middle


def _inside(position: ndarray, loop: ndarray) -> ndarray:
    """Whether points on the face lie inside a star-shaped loop in the front view."""
    center = loop.mean(axis=0)
    offset, spokes = position[:, :2] - center, loop - center
    limit = np.interp(
        np.arctan2(offset[:, 1], offset[:, 0]),
        np.arctan2(spokes[:, 1], spokes[:, 0]),
        np.linalg.norm(spokes, axis=1),
        period=2 * np.pi,
    )
    return (np.linalg.norm(offset, axis=1) < limit) & (position[:, 2] > 0)


def _direction(elevation: ndarray, heading: ndarray) -> ndarray:
    """Unit vectors of angles, rad; heading 0 is the face, π/2 the subject's left."""
    return np.stack(
        (np.cos(elevation) * np.sin(heading), np.sin(elevation), np.cos(elevation) * np.cos(heading)), axis=1
    )


def _coarse_lookup() -> Callable[[ndarray], ndarray]:
    """A function from directions to skin positions, interpolated in a table; accurate enough to measure distances."""
    elevations, headings = np.linspace(-LOWEST, np.pi / 2, 96), np.linspace(0, np.pi, 72)
    grid = np.stack(np.meshgrid(elevations, headings, indexing="ij"), axis=-1)
    table = cast_rays(_direction(grid[..., 0].ravel(), grid[..., 1].ravel())).reshape(96, 72, 3)
    interpolate = RegularGridInterpolator((elevations, headings), table, bounds_error=False, fill_value=None)

    def lookup(directions: ndarray) -> ndarray:
        angles = np.arcsin(np.clip(directions[:, 1], -1, 1)), np.arctan2(np.abs(directions[:, 0]), directions[:, 2])
        return interpolate(np.stack(angles, axis=1))

    return lookup


def _middle_line(lookup: Callable[[ndarray], ndarray]) -> ndarray:
    """Directions in the plane x = 0 at the target spacing, front and back."""
    kept = []
    for heading, lowest in ((0.0, -LOWEST), (np.pi, -LOWEST)):
        elevations = np.linspace(lowest + 0.003, np.pi / 2, 4000)
        line = _direction(elevations, np.full(4000, heading))
        line[:, 0] = 0.0
        points = lookup(line)
        travelled = np.concatenate(
            ([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) / target_spacing(points)[1:]))
        )
        count = int(travelled[-1])
        kept.append(line[np.searchsorted(travelled, (np.arange(count) + 0.7) * travelled[-1] / count)])
    return np.concatenate(kept)


def _poisson_disk(
    lookup: Callable[[ndarray], ndarray], candidates: ndarray, fixed: ndarray, generator: np.random.Generator
) -> ndarray:
    """A maximal subset of `candidates` that keeps the target spacing within itself and to `fixed`."""
    position = lookup(candidates)
    wanted = target_spacing(position)
    thinned = generator.uniform(size=len(candidates)) < np.minimum(1.0, (0.0036 / wanted) ** 1.3)
    free = cKDTree(lookup(fixed)).query(position)[0] > 0.82 * wanted
    candidates, position, wanted = (values[thinned & free] for values in (candidates, position, wanted))
    pairs = cKDTree(position).query_pairs(float(wanted.max()), output_type="ndarray")
    distance = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    pairs = pairs[distance < np.minimum(wanted[pairs[:, 0]], wanted[pairs[:, 1]])]
    kept, undecided = np.zeros(len(position), bool), np.ones(len(position), bool)
    while undecided.any():
        live = pairs[undecided[pairs].all(axis=1)]
        dominated = np.zeros(len(position), bool)
        dominated[live.max(axis=1)] = True
        selected = undecided & ~dominated
        kept |= selected
        undecided &= ~selected
        touched = pairs[selected[pairs].any(axis=1)]
        undecided[touched.ravel()] = False
    return candidates[kept]


def _triangulate(directions: ndarray) -> ndarray:
    """Delaunay triangles of points on the unit sphere, counter-clockwise from outside."""
    faces = ConvexHull(directions).simplices
    a, b, c = (directions[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    return np.where(inwards[:, None], faces[:, ::-1], faces).astype(np.int64)


def _loops(directions: ndarray, lids: ndarray, lips: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Vertex indices of the loops of left lids, right lids and lips."""
    tree = cKDTree(directions)
    left, right, mouth = (np.asarray(tree.query(loop)[1]) for loop in (lids, lids * (-1, 1, 1), lips))
    return left, right, mouth


def _close_lips(vertices: ndarray, lips: ndarray) -> ndarray:
    """Move the loop of the lip margin onto the line between the lips, 0.1 mm above and below it."""
    closed = vertices.copy()
    x = MOUTH_HALF_WIDTH * np.cos(np.arange(LIP_POINTS) * 2 * np.pi / LIP_POINTS)
    side = np.sign(np.round(np.sin(np.arange(LIP_POINTS) * 2 * np.pi / LIP_POINTS), 9))
    closed[lips, 0] = x
    closed[lips, 1] = lip_line_height(x) + 0.0001 * side
    closed[lips, 2] = 0.5 * (vertices[lips, 2] + vertices[lips[(-np.arange(LIP_POINTS)) % LIP_POINTS], 2])
    return closed


def _relax(vertices: ndarray, faces: ndarray, movable: ndarray) -> ndarray:
    """Laplacian smoothing: movable vertices approach the mean of their neighbors and are projected onto the surface."""
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    both = np.concatenate((edges, edges[:, ::-1]))
    graph = coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(len(vertices),) * 2).tocsr()
    graph = graph.multiply(1 / graph.sum(axis=1)[:, None]).tocsr()
    on_sculpture = movable & (vertices[:, 1] > -0.128)
    for _ in range(3):
        vertices = np.where(movable[:, None], vertices + 0.5 * (graph @ vertices - vertices), vertices)
        vertices[on_sculpture] = _to_surface(vertices[on_sculpture])
    return vertices


def _to_surface(points: ndarray) -> ndarray:
    """One Newton step along the distance field's gradient."""
    step = 2e-4
    offsets = np.concatenate((np.zeros((1, 3)), step * np.eye(3)))
    values = skin_distance((points[None] + offsets[:, None]).reshape(-1, 3)).reshape(4, -1)
    gradient = ((values[1:] - values[0]) / step).T
    return points - gradient * (values[0] / np.maximum((gradient**2).sum(axis=1), 0.25))[:, None]
