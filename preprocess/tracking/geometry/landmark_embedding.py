"""Landmarks as points on the triangles of a head: the canonical face is registered to the head once.

The margins of lips and lids are matched first; the other landmarks are then warped along with them and projected onto
the nearest skin.

`closest_points` is kept beside `trimesh.proximity.closest_point`. On MediaPipe's canonical face and on the average face
that replaces it (`ggavatar.landmarks.average_face`), it agrees to 1e-14 m with a search over all triangles, at half the
time or less; trimesh breaks near-ties by the direction to the point, up to 3.4 µm farther, which moves embedded
landmarks by up to 0.40 mm (measured with trimesh 5.2), and needs rtree, which we do not depend on.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.interpolate import RBFInterpolator
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.skin import lip_line_height
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry import landmark_topology as topology

WARP_ROUNDS = 4
"""Alternations of warp and nearest skin points."""
# Positions on the generic head of landmarks that a smooth warp from the margins would misplace, m: nose tip, subnasale,
# wings of the nose.
FEATURES = {
    1: (0.0, -0.0125, 0.0735),
    2: (0.0, -0.0285, 0.0550),
    129: (-0.0182, -0.0190, 0.0495),
    358: (0.0182, -0.0190, 0.0495),
}
LIP_HALF_WIDTH, LIP_HEIGHTS, LIP_DEPTH = 0.0262, (0.0072, -0.0092), 0.050
"""Outline of the generic head's lips about the line between them, m (`ggavatar.head.procedural.skin`)."""
# Landmarks at the border of the face and on the bridge of the nose, where canonical and generic head already agree.
BORDER = (10, 152, 234, 454, 21, 251, 58, 288, 136, 365, 103, 332, 6, 168, 9, 50, 280, 205, 425, 199)
_CANDIDATE_TRIANGLES = 24
"""Triangles with the nearest centers among which the nearest point is searched for."""


@dataclass(frozen=True)
class LandmarkEmbedding:
    """Landmarks as fixed points of a head's triangles.

    Attributes:
        landmarks: Index of each landmark among the 478.
        corners: Vertices of the triangle each landmark lies on.
        weights: Barycentric weights; rows sum to 1.
    """

    landmarks: Int[np.ndarray, " L"]
    corners: Int[np.ndarray, "L 3"]
    weights: Float[np.ndarray, "L 3"]

    def matrix(self, vertices: int) -> csr_array:
        """Sparse map from vertex values to landmark values."""
        rows = np.repeat(np.arange(len(self.landmarks)), 3)
        return csr_array((self.weights.ravel(), (rows, self.corners.ravel())), shape=(len(self.landmarks), vertices))

    def on_head(self, head: HeadModel) -> HeadModel:
        """The head model with its landmark embedding; landmarks without a position get weights of zero."""
        corners, weights = np.zeros((topology.MESH_POINTS, 3), np.int64), np.zeros((topology.MESH_POINTS, 3))
        corners[self.landmarks], weights[self.landmarks] = self.corners, self.weights
        regions = {**head.regions, "landmarks": torch.from_numpy(corners.ravel())}
        return dataclasses.replace(head, regions=regions, landmark_weights=torch.from_numpy(weights).float())


def at_landmarks(matrix: csr_array, values: Float[np.ndarray, "V ..."]) -> Float[np.ndarray, "L ..."]:
    """Vertex values of any trailing shape mapped to landmarks by `LandmarkEmbedding.matrix`."""
    return (matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def embed_landmarks(face: CanonicalFace, head: HeadModel) -> LandmarkEmbedding:
    """Embed all 468 landmarks in the skin of a procedural head.

    The margins of lips and lids are matched along their curves; the other landmarks by alternating a smooth warp and a
    projection onto the nearest skin points.
    """
    template = head.template.numpy().astype(np.float64)
    skin = skin_faces(head)
    anchors, positions, anchor_corners, anchor_weights = _margins(face, head, template)
    front = skin[(template[skin].mean(axis=1)[:, 1] > -0.115)]
    rest = np.setdiff1d(np.arange(topology.MESH_POINTS), anchors)
    warped = _first_warp(face, anchors, positions, (template, front))
    for _ in range(WARP_ROUNDS):
        nearest = closest_points(warped[rest], template, front)[0]
        sources = np.concatenate((face.vertices[anchors], face.vertices[rest]))
        smoothing = np.concatenate((np.full(len(anchors), 1e-7), np.full(len(rest), 1e-5)))
        warped = _warp(face.vertices, sources, np.concatenate((positions, nearest)), smoothing)
    _, corners, weights = closest_points(warped[rest], template, front)
    all_corners, all_weights = np.empty((topology.MESH_POINTS, 3), np.int64), np.empty((topology.MESH_POINTS, 3))
    all_corners[rest], all_weights[rest] = corners, weights
    all_corners[anchors], all_weights[anchors] = anchor_corners, anchor_weights
    return LandmarkEmbedding(np.arange(topology.MESH_POINTS), all_corners, all_weights)


def _first_warp(
    face: CanonicalFace, anchors: np.ndarray, positions: np.ndarray, surface: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The canonical face warped so that its margins, nose and border lie on the head, m."""
    features, border = np.array(list(FEATURES)), np.array(BORDER)
    outline, on_outline = _lip_outline(face)
    wanted = np.concatenate((np.array(list(FEATURES.values())), face.vertices[border], on_outline))
    sources = face.vertices[np.concatenate((anchors, features, border, outline))]
    targets = np.concatenate((positions, closest_points(wanted, *surface)[0]))
    return _warp(face.vertices, sources, targets, 1e-6)


def _lip_outline(face: CanonicalFace) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks on the outer edge of the lips and their positions on the generic head, m."""
    landmarks = topology.OUTER_LIPS
    outline = face.vertices[landmarks]
    across = outline[:, 0] / outline[:, 0].max()
    heights = np.where(outline[:, 1] > outline[np.argmax(across), 1], *LIP_HEIGHTS) * (1 - np.abs(across) ** 2.5)
    x = LIP_HALF_WIDTH * across
    return landmarks, np.stack(
        (x, lip_line_height(x) + heights, np.full(len(x), LIP_DEPTH) - 0.011 * across**2), axis=1
    )


def skin_faces(head: HeadModel) -> Int[np.ndarray, "F 3"]:
    """Triangles of the outer skin, lid margins included."""
    faces, skin = head.faces.numpy(), head.regions["skin"].numpy()
    return faces[np.isin(faces, skin).all(axis=1)]


def boundary_loops(faces: Int[np.ndarray, "F 3"]) -> list[Int[np.ndarray, " R"]]:
    """Closed boundary curves of a surface, each as its vertices in order."""
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    directed = {(int(a), int(b)) for a, b in edges}
    following = {a: b for a, b in directed if (b, a) not in directed}
    loops = []
    while following:
        first, current = following.popitem()
        loop = [first]
        while current != first:
            loop.append(current)
            current = following.pop(current)
        loops.append(np.array(loop))
    return loops


def lip_loop(head: HeadModel) -> Int[np.ndarray, " M"]:
    """Vertices of the lip margin, where skin meets the lining of the mouth, in order.

    Raises:
        ValueError: The head has no closed lip margin.
    """
    bag = set(head.regions["mouth_bag"].tolist())
    faces = head.faces.numpy()
    touching = {int(vertex) for triangle in faces if any(int(v) in bag for v in triangle) for vertex in triangle} - bag
    for loop in boundary_loops(skin_faces(head)):
        if touching.issuperset(loop.tolist()):
            return loop
    raise ValueError("the head has no closed lip margin")


def _margins(
    face: CanonicalFace, head: HeadModel, template: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Landmarks of lip and lid margins: indices, positions, corners (an edge, its end repeated) and weights."""
    curves = []
    left, right = (head.regions[f"{side}_lid_margin"].numpy() for side in ("left", "right"))
    for loop, (upper, lower) in (
        (left, (topology.LEFT_UPPER_LID, topology.LEFT_LOWER_LID)),
        (right, (topology.RIGHT_UPPER_LID, topology.RIGHT_LOWER_LID)),
        (lip_loop(head), (topology.UPPER_LIP_MARGIN, topology.LOWER_LIP_MARGIN)),
    ):
        upper_path, lower_path = _halves(loop, template)
        curves += [(upper, upper_path), (lower, lower_path)]
    found: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    for landmarks, path in curves:
        across = face.vertices[landmarks, 0]
        wanted = (across - across.min()) / np.ptp(across)
        for landmark, fraction in zip(landmarks, wanted, strict=True):
            found[int(landmark)] = _on_path(path, template, float(fraction))
    anchors = np.array(sorted(found))
    parts = [np.stack([found[int(anchor)][k] for anchor in anchors]) for k in range(3)]
    return anchors, parts[0], parts[1], parts[2]


def _halves(loop: np.ndarray, template: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower half of a loop, each from smallest to largest x."""
    loop = np.roll(loop, -int(np.argmin(template[loop, 0])))
    turn = int(np.argmax(template[loop, 0]))
    first, second = loop[: turn + 1], np.append(loop[turn:], loop[0])[::-1]
    upper_first = template[first, 1].mean() > template[second, 1].mean()
    return (first, second) if upper_first else (second, first)


def _on_path(path: np.ndarray, template: np.ndarray, fraction: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The point of a path at a fraction of its extent along x: position, corners and weights."""
    across = template[path, 0]
    x = across[0] + fraction * (across[-1] - across[0])
    index = int(np.clip(np.searchsorted(across, x) - 1, 0, len(path) - 2))
    share = float(np.clip((x - across[index]) / max(across[index + 1] - across[index], 1e-9), 0, 1))
    corners, weights = path[[index, index + 1, index + 1]], np.array([1 - share, share, 0.0])
    return weights @ template[corners], corners, weights


def _warp(points: np.ndarray, sources: np.ndarray, targets: np.ndarray, smoothing: np.ndarray | float) -> np.ndarray:
    """Points after a smooth map of space that takes sources to targets: a thin-plate spline of the displacements.

    Lengths are in decimeters inside, which sets the scale of `smoothing`.
    """
    displacement = RBFInterpolator(
        sources * 10, targets - sources, smoothing=smoothing, kernel="thin_plate_spline", degree=1
    )
    return points + displacement(points * 10)


def closest_points(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Nearest points of a surface: positions, triangle corners and barycentric weights.

    The search is exact among the `_CANDIDATE_TRIANGLES` triangles with the nearest centers.
    """
    triangles = vertices[faces]
    _, near = cKDTree(triangles.mean(axis=1)).query(points, k=min(_CANDIDATE_TRIANGLES, len(faces)))
    near = near.reshape(len(points), -1)
    weights = _nearest_weights(points[:, None], triangles[near])
    positions = np.einsum("nkc,nkcx->nkx", weights, triangles[near])
    best = np.linalg.norm(positions - points[:, None], axis=-1).argmin(axis=1)
    rows = np.arange(len(points))
    return positions[rows, best], faces[near[rows, best]], weights[rows, best]


def _nearest_weights(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Barycentric weights of the nearest point of each triangle.

    It is the foot of the perpendicular if that lies inside, otherwise the nearest point of the edges.
    """
    origin, edge_1, edge_2 = (
        triangles[..., 0, :],
        triangles[..., 1, :] - triangles[..., 0, :],
        triangles[..., 2, :] - triangles[..., 0, :],
    )
    offset = points - origin
    a, b, c = (edge_1**2).sum(-1), (edge_1 * edge_2).sum(-1), (edge_2**2).sum(-1)
    d, e = (edge_1 * offset).sum(-1), (edge_2 * offset).sum(-1)
    determinant = np.maximum(a * c - b * b, 1e-24)
    v, w = (c * d - b * e) / determinant, (a * e - b * d) / determinant
    best = np.stack((1 - v - w, v, w), axis=-1)
    inside = (best >= 0).all(axis=-1)
    distance = np.where(inside, 0.0, np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, along = triangles[..., first, :], triangles[..., second, :] - triangles[..., first, :]
        share = np.clip(((points - start) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-24), 0, 1)
        apart = np.linalg.norm(start + share[..., None] * along - points, axis=-1)
        closer = apart < distance
        on_edge = np.zeros_like(best)
        on_edge[..., first], on_edge[..., second] = 1 - share, share
        best = np.where(closer[..., None], on_edge, best)
        distance = np.where(closer, apart, distance)
    return best
