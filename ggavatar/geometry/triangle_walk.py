"""Walking on a triangle mesh: where a point ends that leaves its triangle, on and on across the edges.

A point is a triangle and three weights of its corners; a shift of it is three numbers that sum to zero. Where the point
leaves a triangle through an edge, the rest of the shift goes on in the neighbor as if the two formed a parallelogram
(SplattingAvatar, Shao et al. 2024, Sec. 3.3). On meshes of parallelograms this is a straight line; elsewhere length and
direction change with the shape of the triangles. Only weights and indices are involved, so triangles without area are
nothing special.

Edges are numbered by the corner opposite to them: edge i runs from corner i + 1 to corner i + 2.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

NO_FACE = -1
"""In `Neighbors`: there is nothing across the edge."""


class Neighbors(NamedTuple):
    """What is across each edge of each triangle.

    Attributes:
        face: The triangle across the edge, or `NO_FACE` at a wall.
        edge: The number of the same edge in that triangle, or `NO_FACE`.
    """

    face: Int[Tensor, "F 3"]
    edge: Int[Tensor, "F 3"]


def neighbors(faces: Int[Tensor, "F 3"]) -> Neighbors:
    """The triangles across all edges of a mesh.

    The neighbor across the directed edge j → l is the triangle that has l → j. An edge is a wall if it has none, if it
    has several (more than two triangles meet, or neighbors are oriented against each other), if its ends are one
    vertex, or if both of its sides are the same triangle. Neighborhood is mutual.

    Args:
        faces: Vertex indices, counter-clockwise seen from outside.
    """
    count = int(faces.max()) + 1 if len(faces) else 1
    start, end = faces[:, [1, 2, 0]].flatten(), faces[:, [2, 0, 1]].flatten()
    keys, order = (start * count + end).sort(stable=True)
    reverse = end * count + start
    first, last = torch.searchsorted(keys, reverse), torch.searchsorted(keys, reverse, right=True)
    own = torch.searchsorted(keys, start * count + end, right=True) - torch.searchsorted(keys, start * count + end)
    across = order[first.clamp_max(max(len(keys) - 1, 0))]
    here = torch.arange(len(start), device=faces.device) // 3
    open_edge = (last - first == 1) & (own == 1) & (across // 3 != here)
    face = torch.where(open_edge, across // 3, NO_FACE).view(-1, 3)
    return Neighbors(face, torch.where(open_edge, across % 3, NO_FACE).view(-1, 3))


@torch.no_grad()
def walk(
    mesh: Neighbors,
    face: Int[Tensor, " N"],
    weights: Float[Tensor, "N 3"],
    shift: Float[Tensor, "N 3"],
    decay: float = 0.9,
    crossings: int = 1_000,
) -> tuple[Int[Tensor, " N"], Float[Tensor, "N 3"]]:
    """Move points on the mesh by shifts of their weights.

    Args:
        mesh: What is across the edges.
        face: The triangle of every point.
        weights: Weights of its corners; nonnegative, sum 1.
        shift: What is added to the weights; sums to 0, any length.
        decay: Factor on what is left of a shift at every crossing, which keeps walks finite.
        crossings: Largest number of crossings of a point.

    Returns:
        The new triangles and weights; these are nonnegative and sum to 1. A point stops at a wall, with a weight of 0,
        and where it has used up its crossings. A point whose shift is 0 or not finite does not move.

    References:
        SplattingAvatar's code, triangle_walk.cpp; the decay is its `cross_triangle_decay`.
    """
    face, weights, shift = face.clone(), weights.clone(), shift.detach()
    moving = ((shift != 0).any(-1) & shift.isfinite().all(-1)).nonzero().squeeze(-1)
    walker = _Walkers(face[moving], weights[moving], shift[moving])
    for _ in range(crossings):
        if not len(moving):
            break
        time, edge = _first_edge(mesh, walker)
        arrived = time >= 1
        reached = walker.weights + torch.where(arrived, 1.0, time)[:, None] * walker.shift
        on_edge = (~arrived)[:, None] & (torch.arange(3, device=edge.device) == edge[:, None])
        reached = torch.where(on_edge, 0.0, reached).clamp_min(0)
        weights[moving] = reached / reached.sum(-1, keepdim=True)
        face[moving] = walker.face
        goes_on = (~arrived & (mesh.face[walker.face, edge] != NO_FACE)).nonzero().squeeze(-1)
        rest = (1 - time[goes_on])[:, None] * walker.shift[goes_on]
        moving = moving[goes_on]
        walker = _across(mesh, walker.face[goes_on], edge[goes_on], weights[moving], decay * rest)
    return face, weights


class _Walkers(NamedTuple):
    """Points under way, and what is left of their shifts."""

    face: Int[Tensor, " M"]
    weights: Float[Tensor, "M 3"]
    shift: Float[Tensor, "M 3"]


def _first_edge(mesh: Neighbors, walker: _Walkers) -> tuple[Float[Tensor, " M"], Int[Tensor, " M"]]:
    """The share of the shift up to the first edge, and the edge; of two at a corner, one that leads on."""
    leaving = walker.shift < 0
    share = torch.where(leaving, walker.weights / torch.where(leaving, -walker.shift, 1.0), torch.inf)
    time = share.amin(-1)
    rank = (share == time[:, None]).long() * (1 + (mesh.face[walker.face] != NO_FACE).long())
    return time, rank.argmax(-1)


def _across(mesh: Neighbors, face: Tensor, edge: Tensor, weights: Tensor, rest: Tensor) -> _Walkers:
    """The same points and shifts in the triangles across an edge, the two being halves of a parallelogram.

    The corners are i (opposite the edge), j and l here, and the new corner is n = j + l − i. So a shift s_i i + s_j j +
    s_l l, whose sum is 0, is −s_l j − s_j l − s_i n.
    """
    row = torch.arange(len(face), device=face.device)
    here_j, here_l = (edge + 1) % 3, (edge + 2) % 3
    new_corner = mesh.edge[face, edge]
    there_l, there_j = (new_corner + 1) % 3, (new_corner + 2) % 3
    there, left = torch.zeros_like(weights), torch.empty_like(rest)
    there[row, there_j], there[row, there_l] = weights[row, here_j], weights[row, here_l]
    left[row, there_j], left[row, there_l] = -rest[row, here_l], -rest[row, here_j]
    left[row, new_corner] = -rest[row, edge]
    return _Walkers(mesh.face[face, edge], there, left)
