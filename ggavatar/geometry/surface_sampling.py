"""Points spread over a triangle mesh in proportion to area."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor


def spread_points(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "N 3"], Int[Tensor, " N"], float]:
    """Points on the surface, every triangle with its share of them to within one (systematic sampling).

    Args:
        vertices: Positions, m.
        faces: Vertex indices.
        count: Number of points.
        generator: On the CPU.

    Returns:
        Positions (m), the face of each, and the distance √(area / count) at which they lie, m.
    """
    corners = vertices[faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = torch.linalg.cross(edges[:, 0], edges[:, 1]).norm(dim=-1).double() / 2
    ends = area.cumsum(0)
    places = (torch.arange(count, dtype=torch.float64) + torch.rand(1, generator=generator).double()) / count
    face = torch.searchsorted(ends, places.to(ends) * ends[-1]).clamp_max(len(faces) - 1)
    u, v = torch.rand(2, count, 1, generator=generator).to(corners)
    beyond = u + v > 1
    u, v = torch.where(beyond, 1 - u, u), torch.where(beyond, 1 - v, v)
    points = corners[face, 0] + u * edges[face, 0] + v * edges[face, 1]
    return points, face, float((ends[-1] / max(count, 1)).sqrt())
