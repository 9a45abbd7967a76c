"""Points that stick to a mesh, one a texel: of the head's own texture layout, or of one that is made for it.

FlashAvatar samples FLAME's texture: every texel that a triangle covers stores this triangle and its barycentric place
in it. The network never sees texture coordinates, so all that a layout decides is how densely which skin is sampled.
A head without a layout therefore gets the plainest one that is free of overlaps and seams: its triangles are laid end
to end, along a curve through the neutral surface, into one strip that the texels divide evenly. Each triangle takes
room by its area, and less if no training frame can show it, as artists do with the back of a head.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ggavatar.core import Camera
from ggavatar.geometry.transforms import project

GOLDEN = 0.6180339887498949
"""Fraction of the golden ratio, whose multiples spread most evenly in [0, 1]."""


class SurfaceSamples(NamedTuple):
    """Places on a mesh.

    Attributes:
        face: Triangle of each sample.
        weights: Barycentric weights of its corners; not negative, sum 1.
    """

    face: Int[Tensor, " N"]
    weights: Float[Tensor, "N 3"]

    def points(self, vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "N 3"]:
        """The samples on a mesh with these vertices, in their unit."""
        corners = vertices[faces[self.face]]
        return (self.weights[:, :, None] * corners).sum(1)


def texel_samples(uv: Float[Tensor, "F 3 2"], side: int) -> SurfaceSamples:
    """One sample for each of `side` × `side` texels whose center a triangle of the layout covers, row by row.

    Args:
        uv: Texture coordinates of every corner in [0, 1].
        side: Texels along an edge of the texture.

    Returns:
        Where triangles overlap, the first of them has the texel.
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
    """Pairs of a triangle and a texel (row-major) within its bounds."""
    low = (grid.amin(1) - 0.5).ceil().clamp(0, side).long()
    size = ((grid.amax(1) - 0.5).floor().clamp(-1, side - 1).long() - low + 1).clamp_min(0)
    count = size.prod(-1)
    face = torch.arange(len(grid)).repeat_interleave(count)
    place = torch.arange(len(face)) - (count.cumsum(0) - count)[face]
    width = size[face, 0]
    return face, (low[face, 1] + place // width) * side + low[face, 0] + place % width


def _barycentric(corners: Float[Tensor, "M 3 2"], points: Float[Tensor, "M 2"]) -> Float[Tensor, "M 3"]:
    """Weights of plane points; −1 in triangles without area."""
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
    """`count` samples that share the strip of all triangles evenly.

    Within a triangle the place along the strip and multiples of the golden ratio make a lattice, which is even in area.

    Args:
        vertices: Neutral positions, m.
        faces: Triangles.
        room: What each takes of the strip, any unit; 0 is left out.
        count: Number of samples; each triangle gets its share of them, rounded up or down.
    """
    order = along_curve(vertices[faces].mean(1))
    ends = room[order].double().cumsum(0)
    ticks = (torch.arange(count, dtype=torch.float64, device=room.device) + 0.5) / count * ends[-1]
    slot = torch.searchsorted(ends, ticks, right=True).clamp_max(len(order) - 1)
    face = order[slot]
    along = ((ticks - ends[slot]) / room[face].double() + 1).clamp(0, 1).sqrt()
    across = (torch.arange(count, dtype=torch.float64, device=room.device) * GOLDEN) % 1
    weights = torch.stack((1 - along, along * (1 - across), along * across), dim=-1)
    return SurfaceSamples(face, weights.to(vertices.dtype))


def along_curve(points: Float[Tensor, "N 3"], bits: int = 10) -> Int[Tensor, " N"]:
    """Order of points along a Z-shaped curve that fills their bounding cube (Morton 1966); neighbors stay close."""
    low = points.amin(0)
    cells = ((points - low) / (points.amax(0) - low).max().clamp_min(1e-12) * (2**bits - 1)).long()
    code = torch.zeros(len(points), dtype=torch.int64, device=points.device)
    for bit in range(bits):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return code.argsort(stable=True)


def face_areas(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, " F"]:
    """Areas of triangles, m² for vertices in m."""
    a, b, c = vertices[faces].unbind(1)
    return torch.linalg.cross(b - a, c - a).norm(dim=-1) / 2


def ever_facing(
    posed: Sequence[Float[Tensor, "V 3"]], cameras: Sequence[Camera], faces: Int[Tensor, "F 3"]
) -> Bool[Tensor, " F"]:
    """Triangles that face the camera, a corner within the image, in one of these views, whatever hides them.

    Args:
        posed: World vertices of each view, m.
        cameras: The camera of each view.
        faces: Triangles, counter-clockwise from outside.
    """
    found = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    for vertices, camera in zip(posed, cameras, strict=True):
        pose = camera.world_to_camera
        a, b, c = (vertices @ pose[:3, :3].T + pose[:3, 3])[faces].unbind(1)
        toward = (torch.linalg.cross(b - a, c - a) * a).sum(-1) < 0
        pixel = project(vertices, camera.intrinsics, pose)
        limit = pixel.new_tensor([camera.width, camera.height])
        found |= toward & ((pixel >= 0) & (pixel < limit)).all(-1)[faces].any(-1) & (a[:, 2] > 0)
    return found


def open_rim(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Bool[Tensor, " F"]:
    """Triangles that touch the lowest open border of the mesh, where neck or bust are cut off; none if it is closed."""
    edges = torch.cat((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    kinds, number = torch.unique(edges.sort(-1).values, dim=0, return_counts=True)
    border = kinds[number == 1]
    touched = torch.zeros(len(vertices), dtype=torch.bool, device=faces.device)
    if len(border):
        touched[border[vertices[border].mean(1)[:, 1].argmin()]] = True
        while bool((grows := touched[border].any(-1) & ~touched[border].all(-1)).any()):
            touched[border[grows]] = True
    return touched[faces].any(-1)
