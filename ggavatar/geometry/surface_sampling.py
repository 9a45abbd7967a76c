"""Points sampled on a triangle mesh in proportion to area.

`trimesh.sample.sample_surface` draws every point's face independently, in numpy; here the faces are stratified, the
generator and the device are torch's, and training starts without importing trimesh.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor


def sample_surface(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "N 3"], Int[Tensor, " N"], float]:
    """Sample points on the surface; every triangle gets its share by area to within one (systematic sampling).

    Args:
        vertices: Positions, m.
        faces: Vertex indices.
        count: Number of points.
        generator: Random generator on the CPU.

    Returns:
        Positions (m), the face of each, and their mean spacing √(area / count), m.
    """
    corners = vertices[faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = torch.linalg.cross(edges[:, 0], edges[:, 1]).norm(dim=-1).double() / 2
    ends = area.cumsum(0)
    fractions = (torch.arange(count, dtype=torch.float64) + torch.rand(1, generator=generator).double()) / count
    face = torch.searchsorted(ends, fractions.to(ends) * ends[-1]).clamp_max(len(faces) - 1)
    u, v = torch.rand(2, count, 1, generator=generator).to(corners)
    outside = u + v > 1
    u, v = torch.where(outside, 1 - u, u), torch.where(outside, 1 - v, v)
    points = corners[face, 0] + u * edges[face, 0] + v * edges[face, 1]
    return points, face, float((ends[-1] / max(count, 1)).sqrt())
