"""Rasterization of meshes: a z-buffer with perspective-correct barycentric weights.

Samples are the pixels of a finer image, which the caller averages. Kernels are single-threaded, so that frames can be
rendered in parallel. `project` and `vertex_normals` differ from their namesakes in the last bits (other order of the
same operations), on which the generated images depend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.jit.kernels import kernel

NOTHING = -1
"""Face index of samples without a face."""
_NEAR = 0.05
"""Depth below which triangles are left out, m."""


@dataclass(frozen=True)
class Visibility:
    """The nearest surface in every sample.

    Attributes:
        face: Index of the nearest face; −1 where there is none.
        weights: Barycentric weights of the second and third corner, perspective-correct.
        depth: Camera z, m; infinite where there is no face.
    """

    face: Int[ndarray, "H W"]
    weights: Float[ndarray, "H W 2"]
    depth: Float[ndarray, "H W"]


def project(
    points: Float[ndarray, "V 3"], intrinsics: Float[ndarray, "3 3"], world_to_camera: Float[ndarray, "4 4"]
) -> Float[ndarray, "V 3"]:
    """Pixel x, pixel y (centers at +0.5) and camera z in m of world points."""
    seen = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    depth = seen[:, 2]
    x = seen[:, 0] * intrinsics[0, 0] / depth + intrinsics[0, 2]
    y = seen[:, 1] * intrinsics[1, 1] / depth + intrinsics[1, 2]
    return np.stack((x, y, depth), axis=1).astype(np.float32)


def rasterize(pixels: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], height: int, width: int) -> Visibility:
    """The nearest triangle in every sample.

    Args:
        pixels: Position in samples (centers at +0.5) and camera z, m. Triangles nearer than 5 cm are left out.
        faces: Vertex indices; both sides are visible.
        height: Number of rows.
        width: Number of columns.
    """
    face = np.full((height, width), NOTHING, np.int32)
    weights = np.zeros((height, width, 2), np.float32)
    depth = np.full((height, width), np.inf, np.float32)
    _fill(np.ascontiguousarray(pixels, np.float32), np.ascontiguousarray(faces, np.int32), face, weights, depth)
    return Visibility(face, weights, depth)


@kernel
def _fill(pixels, faces, face, weights, depth):
    """Walk every triangle's bounding box with edge functions; nearest inverse depth wins, ties go to the first face."""
    height, width = depth.shape
    for index in range(faces.shape[0]):
        a, b, c = faces[index, 0], faces[index, 1], faces[index, 2]
        ax, ay, az = pixels[a, 0], pixels[a, 1], pixels[a, 2]
        bx, by, bz = pixels[b, 0], pixels[b, 1], pixels[b, 2]
        cx, cy, cz = pixels[c, 0], pixels[c, 1], pixels[c, 2]
        if min(az, bz, cz) < _NEAR:
            continue
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        left, right = max(0, int(np.ceil(min(ax, bx, cx) - 0.5))), min(width - 1, int(np.floor(max(ax, bx, cx) - 0.5)))
        top, bottom = max(0, int(np.ceil(min(ay, by, cy) - 0.5))), min(height - 1, int(np.floor(max(ay, by, cy) - 0.5)))
        for row in range(top, bottom + 1):
            py = row + 0.5
            for column in range(left, right + 1):
                px = column + 0.5
                second = ((px - ax) * (cy - ay) - (cx - ax) * (py - ay)) / area
                third = ((bx - ax) * (py - ay) - (px - ax) * (by - ay)) / area
                first = 1.0 - second - third
                if first < 0 or second < 0 or third < 0:
                    continue
                inverse = first / az + second / bz + third / cz
                distance = 1.0 / inverse
                if distance < depth[row, column]:
                    depth[row, column] = distance
                    face[row, column] = index
                    weights[row, column, 0] = second / bz * distance
                    weights[row, column, 1] = third / cz * distance


def vertex_normals(points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "V 3"]:
    """Unit normals: area-weighted averages over the faces around each vertex."""
    normals = np.zeros((len(points), 3))
    _add_normals(np.ascontiguousarray(points, np.float64), np.ascontiguousarray(faces, np.int32), normals)
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)).astype(np.float32)


@kernel
def _add_normals(points, faces, normals):
    """Add every face's area vector to its three corners."""
    for index in range(faces.shape[0]):
        a, b, c = faces[index, 0], faces[index, 1], faces[index, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (a, b, c):
            normals[corner, 0] += nx
            normals[corner, 1] += ny
            normals[corner, 2] += nz
