"""Points attached to a mesh, one per texel: of the head's own UV layout, or of one that is generated for it.

FlashAvatar samples FLAME's texture: every texel that a triangle covers stores the triangle and its barycentric
coordinates in it. The network never sees texture coordinates, so a layout only decides how densely each part of the
skin is sampled. A head without a layout therefore gets the simplest one that has no overlaps and no seams: its
triangles are laid end to end, along a curve through the neutral surface, in one strip that the texels divide evenly.
Each triangle takes a share by its area, and less if no training frame can show it, as in layouts made by artists.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ggavatar.core import Camera
from ggavatar.geometry.transforms import project

GOLDEN_RATIO_FRACTION = 0.6180339887498949
"""Fractional part of the golden ratio; its multiples modulo 1 are spread evenly over [0, 1)."""


class SurfaceSamples(NamedTuple):
    """Points on a mesh, as barycentric coordinates.

    Attributes:
        face: Triangle of each sample.
        weights: Barycentric weights of its corners; nonnegative, sum 1.
    """

    face: Int[Tensor, " N"]
    weights: Float[Tensor, "N 3"]

    def points(self, vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "N 3"]:
        """Positions of the samples on a mesh with these vertices, in the vertices' unit."""
        corners = vertices[faces[self.face]]
        return (self.weights[:, :, None] * corners).sum(1)


def texel_samples(uv: Float[Tensor, "F 3 2"], side: int) -> SurfaceSamples:
    """One sample for each of `side` × `side` texels whose center a triangle of the UV layout covers, row by row.

    Args:
        uv: Texture coordinates of every corner, in [0, 1].
        side: Texels along an edge of the texture.

    Returns:
        The samples; where triangles overlap, the texel belongs to the first of them.
    """
    grid = uv.double().cpu() * side
    face, texel = _candidates(grid, side)
    centers = torch.stack((texel % side, texel // side), dim=-1) + 0.5
    weights = _barycentric(grid[face], centers)
    inside = (weights >= -1e-9).all(-1)
    face, texel, weights = face[inside], texel[inside], weights[inside].clamp_min(0)
    owner = torch.full((side * side,), len(uv)).scatter_reduce(0, texel, face, "amin")
    first = owner[texel] == face
    order = texel[first].argsort()
    weights = weights[first][order]
    samples = SurfaceSamples(face[first][order], (weights / weights.sum(-1, keepdim=True)).float())
    return SurfaceSamples(*(values.to(uv.device) for values in samples))


def _candidates(grid: Float[Tensor, "F 3 2"], side: int) -> tuple[Int[Tensor, " M"], Int[Tensor, " M"]]:
    """Pairs of a triangle and a texel (row-major index) within the triangle's bounding box."""
    low = (grid.amin(1) - 0.5).ceil().clamp(0, side).long()
    size = ((grid.amax(1) - 0.5).floor().clamp(-1, side - 1).long() - low + 1).clamp_min(0)
    count = size.prod(-1)
    face = torch.arange(len(grid)).repeat_interleave(count)
    offset = torch.arange(len(face)) - (count.cumsum(0) - count)[face]
    width = size[face, 0]
    return face, (low[face, 1] + offset // width) * side + low[face, 0] + offset % width


def _barycentric(corners: Float[Tensor, "M 3 2"], points: Float[Tensor, "M 2"]) -> Float[Tensor, "M 3"]:
    """Barycentric weights of points in the plane; −1 in triangles without area."""
    a, b, c = corners.unbind(1)
    area = _cross(b - a, c - a)
    parts = torch.stack((_cross(c - b, points - b), _cross(a - c, points - c), _cross(b - a, points - a)), dim=-1)
    flat = area.abs() < 1e-15
    return torch.where(flat[:, None], -1.0, parts / area.where(~flat, area.new_tensor(1.0))[:, None])


def _cross(a: Float[Tensor, "M 2"], b: Float[Tensor, "M 2"]) -> Float[Tensor, " M"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def strip_samples(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], room: Float[Tensor, " F"], count: int
) -> SurfaceSamples:
    """`count` samples, evenly spaced along the strip of all triangles.

    Within a triangle, the position along the strip and multiples of the golden ratio form a lattice that is uniform in
    area.

    Args:
        vertices: Neutral positions, m.
        faces: Vertex indices.
        room: Length that each triangle takes of the strip, any unit; triangles with 0 get no samples.
        count: Number of samples; each triangle gets its share of them, rounded up or down.
    """
    order = morton_order(vertices[faces].mean(1))
    ends = room[order].double().cumsum(0)
    ticks = (torch.arange(count, dtype=torch.float64, device=room.device) + 0.5) / count * ends[-1]
    slot = torch.searchsorted(ends, ticks, right=True).clamp_max(len(order) - 1)
    face = order[slot]
    along = ((ticks - ends[slot]) / room[face].double() + 1).clamp(0, 1).sqrt()
    across = (torch.arange(count, dtype=torch.float64, device=room.device) * GOLDEN_RATIO_FRACTION) % 1
    weights = torch.stack((1 - along, along * (1 - across), along * across), dim=-1)
    return SurfaceSamples(face, weights.to(vertices.dtype))


def morton_order(points: Float[Tensor, "N 3"], bits: int = 10) -> Int[Tensor, " N"]:
    """Order of points along the Z-order curve of their bounding cube (Morton 1966), which keeps neighbors close."""
    low = points.amin(0)
    cells = ((points - low) / (points.amax(0) - low).max().clamp_min(1e-12) * (2**bits - 1)).long()
    code = torch.zeros(len(points), dtype=torch.int64, device=points.device)
    for bit in range(bits):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return code.argsort(stable=True)


def face_areas(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, " F"]:
    """Areas of triangles, m² for vertices in m (`trimesh.triangles.area` for torch tensors)."""
    a, b, c = vertices[faces].unbind(1)
    return torch.linalg.cross(b - a, c - a).norm(dim=-1) / 2


def camera_facing(
    posed: Sequence[Float[Tensor, "V 3"]], cameras: Sequence[Camera], faces: Int[Tensor, "F 3"]
) -> Bool[Tensor, " F"]:
    """Which triangles face the camera with a corner in the image in at least one view; occlusion is ignored.

    Args:
        posed: World vertices of each view, m.
        cameras: The camera of each view.
        faces: Vertex indices, counter-clockwise seen from outside.
    """
    found = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    for vertices, camera in zip(posed, cameras, strict=True):
        pose = camera.world_to_camera
        a, b, c = (vertices @ pose[:3, :3].T + pose[:3, 3])[faces].unbind(1)
        front_facing = (torch.linalg.cross(b - a, c - a) * a).sum(-1) < 0
        pixel = project(vertices, camera.intrinsics, pose)
        limit = pixel.new_tensor([camera.width, camera.height])
        found |= front_facing & ((pixel >= 0) & (pixel < limit)).all(-1)[faces].any(-1) & (a[:, 2] > 0)
    return found


def lower_boundary(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Bool[Tensor, " F"]:
    """Which triangles touch the lowest boundary loop, where neck or bust end; none if the mesh is closed."""
    edges = torch.cat((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    unique_edges, number = torch.unique(edges.sort(-1).values, dim=0, return_counts=True)
    border = unique_edges[number == 1]
    touched = torch.zeros(len(vertices), dtype=torch.bool, device=faces.device)
    if len(border):
        touched[border[vertices[border].mean(1)[:, 1].argmin()]] = True
        while bool((grows := touched[border].any(-1) & ~touched[border].all(-1)).any()):
            touched[border[grows]] = True
    return touched[faces].any(-1)
