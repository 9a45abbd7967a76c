"""Extending displacements of landmarks to all vertices of a surface.

The displacement found is the smoothest that moves the landmarks as given. Smooth means a small squared Laplacian over
the surface's own edges (Sorkine et al. 2004), so nothing crosses the slit between the lips.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

STIFFNESS = 0.05
"""Weight of the squared Laplacian against the squared residuals of landmarks."""


class SurfaceExtension:
    """A linear map from landmark displacements to displacements of a head's vertices, factorized once."""

    def __init__(
        self, faces: Int[np.ndarray, "F 3"], landmarks: csr_array, anchor_weights: Float[np.ndarray, " V"]
    ) -> None:
        """Prepare the map.

        Args:
            faces: Triangles of the surface that may move; vertices in none of them stay in place.
            landmarks: Sparse map from vertex values to landmark values.
            anchor_weights: How strongly each vertex is held in place (0 is free, 1 as strong as a landmark).
        """
        count = landmarks.shape[1]
        laplacian = _laplacian(faces, count)
        unused = np.ones(count)
        unused[np.unique(faces)] = 0
        system = (
            STIFFNESS * (laplacian.T @ laplacian)
            + landmarks.T @ landmarks
            + diags_array(anchor_weights + unused + 1e-7)
        )
        self._solver = splu(csc_array(system))
        self._landmarks = landmarks

    def __call__(self, displacements: Float[np.ndarray, "L ..."]) -> Float[np.ndarray, "V ..."]:
        """Displacements of all vertices, in the unit and with the trailing shape of those given."""
        flat = displacements.reshape(len(displacements), -1)
        solved = self._solver.solve(np.ascontiguousarray(self._landmarks.T @ flat))
        return solved.reshape(len(solved), *displacements.shape[1:])


def _laplacian(faces: np.ndarray, count: int) -> csr_array:
    """Each vertex minus the mean of its neighbors; border edges count like others."""
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    edges = np.unique(np.sort(np.concatenate((edges, edges[:, ::-1])), axis=1), axis=0)
    rows, columns = np.concatenate((edges[:, 0], edges[:, 1])), np.concatenate((edges[:, 1], edges[:, 0]))
    adjacency = csr_array(coo_array((np.ones(len(rows)), (rows, columns)), shape=(count, count)))
    degree = adjacency.sum(axis=1)
    scaled = diags_array(1 / np.maximum(degree, 1)) @ adjacency
    return csr_array(diags_array((degree > 0).astype(float)) - scaled)
