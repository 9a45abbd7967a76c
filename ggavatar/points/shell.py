"""Points on the skin of a head and off it, along its normals: hair, glasses and collars, which head models do not have.

Lengths in m. PSAvatar (Zhao et al. 2024) draws triangles by area, places in them at random, and offsets along the
normal; how far they reach is not told. In the face its figure has hardly any cloud, elsewhere one of 55 to 60 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.geometry.vertex_frames import vertex_normals
from ggavatar.head.model import HeadModel

INTERIOR = ("mouth_bag", "teeth", "upper_teeth", "lower_teeth", "tongue", "left_eyeball", "right_eyeball")
"""Regions in the mouth and behind the lids, whose normals point into the head: nothing is placed off them."""

CANDIDATES = 2
"""Places tried for each point off the skin; those too close to another part of the skin are left out."""

CLEARANCE = 0.5
"""Distance from the nearest vertex, as a share of the offset, from which a point counts as off the skin (ours)."""


class Shell(NamedTuple):
    """Points by their triangle, the weights of its corners, and an offset along the smooth normal of the neutral head.

    Attributes:
        face: Triangle of each point.
        weights: Weights of its corners; nonnegative, sum 1.
        offsets: Distance along the normal, m; 0 on the skin.
    """

    face: Int[Tensor, " N"]
    weights: Float[Tensor, "N 3"]
    offsets: Float[Tensor, " N"]

    def points(self, head: HeadModel) -> Float[Tensor, "N 3"]:
        """Their places on and off the neutral head: Σ w_j v_j + h unit(Σ w_j n_j), m."""
        vertices = head.neutral()
        corners = head.faces[self.face]
        weights = self.weights[:, :, None]
        normals = normalize((weights * vertex_normals(vertices, head.faces)[corners]).sum(1), dim=-1)
        return (weights * vertices[corners]).sum(1) + self.offsets[:, None] * normals


class ShellRanges(NamedTuple):
    """Lowest and highest offset, m, off the face and off everything else."""

    face: tuple[float, float]
    rest: tuple[float, float]


def sample_shell(
    head: HeadModel,
    room: Float[Tensor, " F"],
    counts: tuple[int, int],
    ranges: ShellRanges,
    generator: torch.Generator,
) -> Shell:
    """Points on the skin, then points off it at uniform offsets.

    Args:
        head: The head, on any device; the points are on it too.
        room: Share of each triangle in the points, any unit, such as its area.
        counts: Number of points on the skin and off it.
        ranges: Offsets of the latter; a head without the region `face` is `rest` everywhere.
        generator: Random generator on the CPU.

    Returns:
        The points; off the skin none belongs to a triangle of `INTERIOR`, and none is closer to a vertex than half of
        its offset, if that can be had.
    """
    local = head.to("cpu")
    room = room.detach().cpu()
    on = _draw(room, counts[0], generator)
    outside = room * ~triangles_of(local, INTERIOR, touching=True)
    off = _draw(outside if bool(outside.any()) else room, CANDIDATES * counts[1], generator)
    low, high = (torch.tensor(pair) for pair in zip(ranges.rest, ranges.face, strict=True))
    in_face = triangles_of(local, ("face",))[off.face].long()
    share = torch.rand(len(in_face), generator=generator)
    off = off._replace(offsets=low[in_face] + share * (high - low)[in_face])
    kept = _some_clear(local, off, counts[1])
    joined = (torch.cat((one, other[kept])) for one, other in zip(on, off, strict=True))
    return Shell(*(values.to(head.faces.device) for values in joined))


def triangles_of(head: HeadModel, names: Sequence[str], *, touching: bool = False) -> Bool[Tensor, " F"]:
    """Which triangles have all corners in some regions, or at least one if `touching`; none without the regions."""
    inside = torch.zeros(len(head.template), dtype=torch.bool, device=head.faces.device)
    for name in names:
        if name in head.regions:
            inside[head.regions[name]] = True
    corners = inside[head.faces]
    return corners.any(1) if touching else corners.all(1)


def _draw(room: Tensor, count: int, generator: torch.Generator) -> Shell:
    """Systematic sampling of triangles, each its share to within one, and a uniform place in each."""
    ends = room.double().cumsum(0)
    ticks = (torch.arange(count, dtype=torch.float64) + torch.rand(1, generator=generator).double()) / max(count, 1)
    face = torch.searchsorted(ends, ticks * ends[-1], right=True).clamp_max(len(room) - 1)
    along, across = torch.rand(2, count, generator=generator)
    along = along.sqrt()
    weights = torch.stack((1 - along, along * (1 - across), along * across), dim=1)
    return Shell(face, weights, torch.zeros(count))


def _some_clear(head: HeadModel, off: Shell, count: int) -> Int[Tensor, " N"]:
    """Rows of `count` candidates, spread over all those that are clear of the skin; over all if none is."""
    distance = KDTree(head.neutral().numpy()).query(off.points(head).numpy())[0]
    clear = torch.from_numpy(np.asarray(distance)) >= CLEARANCE * off.offsets.abs()
    rows = clear.nonzero().squeeze(-1)
    rows = rows if len(rows) else torch.arange(len(clear))
    return rows[torch.arange(count) * len(rows) // max(count, 1)]
