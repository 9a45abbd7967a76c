"""One level of Loop subdivision as a sparse matrix, which refines the head in every frame.

Not `trimesh.remesh.subdivide_loop`: it gives vertices, not a matrix (129 ms a frame against 0.4 ms), and its weights
for irregular vertices are Loop's, not Warren's, which would move vertices by up to 0.9 mm and change every image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import coo_array, csr_array


@dataclass(frozen=True)
class Subdivision:
    """A refinement of a mesh.

    Attributes:
        weights: Fine vertices as linear combinations of coarse ones; rows sum to 1.
        faces: Fine triangles, four for each coarse one, in the coarse order.
    """

    weights: csr_array
    faces: Int[ndarray, "G 3"]

    def corners(self, values: Float[ndarray, "F 3 K"]) -> Float[ndarray, "G 3 K"]:
        """Values at the corners of the coarse faces (such as texture coordinates), interpolated to the fine faces."""
        a, b, c = values[:, 0], values[:, 1], values[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quads = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        return np.stack([np.stack(quad, axis=1) for quad in quads], axis=1).reshape(-1, 3, values.shape[2])


def subdivide(faces: Int[ndarray, "F 3"], count: int) -> Subdivision:
    """Loop subdivision (1987) with Warren's weights; boundary edges are subdivided as cubic splines.

    Args:
        faces: Coarse triangles.
        count: Number of coarse vertices.
    """
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    unique, inverse, uses = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    middle = inverse.reshape(3, -1).T + count
    a, b, c = faces.T
    ab, bc, ca = middle.T
    fine = np.stack(
        (np.stack((a, ab, ca), 1), np.stack((ab, b, bc), 1), np.stack((ca, bc, c), 1), np.stack((ab, bc, ca), 1)),
        axis=1,
    )
    inner = uses == 2
    old = _old_vertices(unique, inner, count)
    new = _edge_vertices(unique, inner, inverse, faces, count)
    rows, columns, values = (np.concatenate(parts) for parts in zip(old, new, strict=True))
    weights = coo_array((values, (rows, columns)), shape=(count + len(unique), count)).tocsr()
    return Subdivision(weights, fine.reshape(-1, 3))


def _old_vertices(unique: ndarray, inner: ndarray, count: int) -> tuple[ndarray, ndarray, ndarray]:
    """Matrix entries of the coarse vertices, averaged with their neighbors, or boundary neighbors on a boundary."""
    on_edge = np.zeros(count, bool)
    on_edge[unique[~inner].ravel()] = True
    both = np.concatenate((unique, unique[:, ::-1]))
    boundary = np.concatenate((~inner, ~inner))
    used = np.where(on_edge[both[:, 0]], boundary, True)
    both = both[used]
    valence = np.bincount(both[:, 0], minlength=count)
    beta = np.where(on_edge, 1 / 8, np.where(valence == 3, 3 / 16, 3 / (8 * np.maximum(valence, 1))))
    stay = np.arange(count)
    rows = np.concatenate((stay, both[:, 0]))
    columns = np.concatenate((stay, both[:, 1]))
    values = np.concatenate((1 - valence * beta, beta[both[:, 0]]))
    return rows, columns, values


def _edge_vertices(
    unique: ndarray, inner: ndarray, inverse: ndarray, faces: ndarray, count: int
) -> tuple[ndarray, ndarray, ndarray]:
    """Matrix entries of edge vertices: 3/8 of each end and 1/8 of each opposite vertex; midpoints on a boundary."""
    number = np.arange(len(unique)) + count
    ends = np.where(inner, 3 / 8, 1 / 2)
    opposite = np.concatenate((faces[:, 2], faces[:, 0], faces[:, 1]))
    edge = inverse.ravel()
    used = inner[edge]
    rows = np.concatenate((number, number, edge[used] + count))
    columns = np.concatenate((unique[:, 0], unique[:, 1], opposite[used]))
    values = np.concatenate((ends, ends, np.full(int(used.sum()), 1 / 8)))
    return rows, columns, values
