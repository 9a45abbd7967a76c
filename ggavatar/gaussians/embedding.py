"""Gaussians embedded on a mesh: a triangle, weights of its corners, and a distance along the smooth normal.

Rows have the columns quats [N, 4], log_scales [N, 3] (of m, at rest), distances [N] (m) and slides [N, 2], and carry
face [N] and weights [N, 3]. The first two weights of a Gaussian are those carried plus its slides; the third follows.
Walking (`ggavatar.geometry.triangle_walk`) moves the slides into the carried weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.gaussians.binding import WorldGeometry
from ggavatar.gaussians.density_control import SPLIT_CHILDREN, SPLIT_SHRINK
from ggavatar.geometry.transforms import quaternion_multiply, quaternion_to_matrix
from ggavatar.geometry.triangle_walk import Neighbors, walk
from ggavatar.geometry.vertex_frames import RestFrames, face_vectors, vertex_normals, vertex_turns
from ggavatar.optim.parameters import Rows

ScaleRule = Literal["area", "length", "log", "none"]
"""How the change of a triangle's area acts on the scales of its Gaussians; see `scaled_by_area`."""

AUTHORS_UNITS_PER_METER = 4.0
"""SplattingAvatar's FLAME is four times as large as ours; the rule `log` depends on it."""

STEEP = 1e-3
"""Cosine of the angle between smooth normal and triangle below which the triangle's own normal is used in splits."""

ROUNDS = 2
"""Times that a child of a split looks for its place; one leaves 6 % of a standard deviation of 3 mm, two nothing."""


class PosedMesh(NamedTuple):
    """A mesh in some pose, as embedded Gaussians see it.

    Attributes:
        vertices: Positions, m.
        normals: Smooth unit normals of the vertices.
        turns: Rotations of the vertices since rest, unit quaternions wxyz.
        areas: Areas of the triangles, m².
    """

    vertices: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    turns: Float[Tensor, "V 4"]
    areas: Float[Tensor, " F"]


@dataclass(frozen=True)
class RestMesh:
    """The mesh at rest, in which scales and rotations are stored and splits happen.

    Attributes:
        vertices: Positions, m.
        faces: Vertex indices.
        frames: Axes and areas of the triangles.
    """

    vertices: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    frames: RestFrames

    @staticmethod
    def of(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> RestMesh:
        """The mesh with these vertices, m."""
        return RestMesh(vertices, faces, RestFrames.of(vertices, faces))

    def posed(self, vertices: Float[Tensor, "V 3"]) -> PosedMesh:
        """The mesh with its vertices moved to `vertices`, m."""
        vectors = face_vectors(vertices, self.faces)
        normals = vertex_normals(vertices, self.faces, vectors)
        return PosedMesh(vertices, normals, vertex_turns(self.frames, vertices, self.faces), vectors.norm(dim=-1) / 2)


class Places(NamedTuple):
    """Places on a mesh.

    Attributes:
        face: The triangle of every Gaussian.
        weights: Weights of its corners; they sum to 1, and may be negative before a walk.
        distances: Distance along the smooth normal, m.
    """

    face: Int[Tensor, " N"]
    weights: Float[Tensor, "N 3"]
    distances: Float[Tensor, " N"]

    @staticmethod
    def of(rows: Rows) -> Places:
        """The places of rows, through which gradients flow into slides and distances."""
        return Places(rows["face"], rows["weights"] + slide_shift(rows["slides"]), rows["distances"])


def slide_shift(slides: Float[Tensor, "N 2"]) -> Float[Tensor, "N 3"]:
    """The changes (u, v, −u − v) of the three weights."""
    return torch.cat((slides, -slides.sum(1, keepdim=True)), dim=1)


def embed(
    places: Places,
    quats: Float[Tensor, "N 4"],
    log_scales: Float[Tensor, "N 3"],
    rest: RestMesh,
    posed: PosedMesh,
    rule: ScaleRule,
    damping: float,
) -> WorldGeometry:
    """Gaussians at their places on a posed mesh.

    μ = Σ b_j v_j + d n with n = unit(Σ b_j n_j), r = unit((Σ b_j q_j) r0) with the turns q_j of the corners, and s by
    `scaled_by_area`.

    Args:
        places: Where the Gaussians are.
        quats: Rotations at rest, wxyz, of any nonzero length.
        log_scales: Logarithms of the standard deviations at rest in m.
        rest: The mesh at rest.
        posed: The mesh in the pose.
        rule: How areas act on scales.
        damping: Added to both areas, m².

    References:
        SplattingAvatar (Shao et al. 2024), Eq. 1–3 (μ), Eq. 6–7 (r; its code does not align signs), Eq. 8 (s).
    """
    columns = torch.cat((posed.vertices, posed.normals, posed.turns), dim=1)
    corners = columns.index_select(0, rest.faces.index_select(0, places.face).flatten()).unflatten(0, (-1, 3))
    point, normal, turn = (places.weights[:, :, None] * corners).sum(1).split((3, 3, 4), dim=1)
    means = point + places.distances[:, None] * normalize(normal, dim=-1)
    turned = normalize(quaternion_multiply(turn, normalize(quats, dim=-1)), dim=-1)
    ratio = (posed.areas + damping) / (rest.frames.areas + damping)
    return WorldGeometry(means, turned, scaled_by_area(log_scales, ratio.index_select(0, places.face), rule))


def scaled_by_area(log_scales: Float[Tensor, "N 3"], ratio: Float[Tensor, " N"], rule: ScaleRule) -> Tensor:
    """Standard deviations in m, where the triangles' areas have changed by `ratio`.

    `area` multiplies by the ratio (Eq. 8 of the paper), `length` by its root, `log` raises to its power (the public
    code, in its unit of quarter meters), `none` leaves them. In `log`, Gaussians smaller than the unit shrink on a
    triangle that grows.
    """
    factor = ratio[:, None]
    if rule == "log":
        unit = math.log(AUTHORS_UNITS_PER_METER)
        return ((log_scales + unit) * factor - unit).exp()
    if rule == "none":
        return log_scales.exp()
    return log_scales.exp() * (factor if rule == "area" else factor.sqrt())


@torch.no_grad()
def absorb_slides(rows: Rows, mesh: Neighbors, decay: float) -> None:
    """Walk every Gaussian by its slides, which become 0 with zero moments; distances keep theirs.

    References:
        SplattingAvatar, Sec. 3.3 (lifted optimization): the optimizer moves Gaussians over the surface.
    """
    face, weights = walk(mesh, rows["face"], rows["weights"], slide_shift(rows["slides"]), decay)
    rows["face"].copy_(face)
    rows["weights"].copy_(weights)
    rows.replace("slides", torch.zeros_like(rows["slides"]))


@dataclass(frozen=True)
class EmbeddedSplit:
    """Splits Gaussians on the mesh at rest.

    Attributes:
        rest: The mesh at rest.
        mesh: What is across its edges.
        decay: Factor on the rest of a walk at every crossing.
        along_normal: Whether children move along the normal too; in the public code they keep their parent's distance.
    """

    rest: RestMesh
    mesh: Neighbors
    decay: float
    along_normal: bool = False

    @torch.no_grad()
    def __call__(self, rows: Rows, chosen: Tensor, generator: torch.Generator) -> None:
        """Replace every chosen row by two smaller ones on the mesh, drawn from its own distribution."""
        parents = {name: values[chosen].repeat_interleave(SPLIT_CHILDREN, 0) for name, values in rows.columns().items()}
        deviation = parents["log_scales"].exp()
        noise = torch.randn(deviation.shape, generator=generator).to(deviation)
        offset = (quaternion_to_matrix(parents["quats"]) @ (deviation * noise)[..., None]).squeeze(-1)
        begin = Places(parents["face"], parents["weights"], parents["distances"])
        face, weights, distances = self.placed(begin, slide_shift(parents["slides"]), offset)
        children = {
            **parents,
            "face": face,
            "weights": weights,
            "slides": torch.zeros_like(parents["slides"]),
            "distances": distances if self.along_normal else parents["distances"],
            "log_scales": parents["log_scales"] - math.log(SPLIT_SHRINK),
        }
        rows.append(children)
        kept = torch.cat((~chosen, chosen.new_ones(len(face))))
        rows.take(kept.nonzero().squeeze(-1))

    def placed(self, begin: Places, slide: Float[Tensor, "N 3"], offset: Float[Tensor, "N 3"]) -> Places:
        """The places on the mesh at rest closest to points beside other places.

        Args:
            begin: The other places, before their slides.
            slide: Their slides.
            offset: From there to the points, m.

        Returns:
            The places, with the distances at which they would be those points.
        """
        normals = vertex_normals(self.rest.vertices, self.rest.faces)
        point, normal, _ = self._local(begin._replace(weights=begin.weights + slide), normals)
        target = point + begin.distances[:, None] * normal + offset
        place = begin
        for attempt in range(ROUNDS):
            ahead = place._replace(weights=place.weights + slide) if attempt == 0 else place
            point, normal, edges = self._local(ahead, normals)
            solved = solve_on_triangle(target - point, edges, normal)
            shift = slide_shift(solved[:, :2]) + (slide if attempt == 0 else 0.0)
            face, weights = walk(self.mesh, place.face, place.weights, shift, self.decay)
            place = Places(face, weights, solved[:, 2])
        return place

    def _local(self, place: Places, normals: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Point of the surface, smooth normal and two edges (of the first two weights) of every place."""
        index = self.rest.faces[place.face]
        corners = self.rest.vertices[index]
        point = (place.weights[:, :, None] * corners).sum(1)
        normal = normalize((place.weights[:, :, None] * normals[index]).sum(1), dim=-1)
        return point, normal, corners[:, :2] - corners[:, 2:]


def solve_on_triangle(
    offset: Float[Tensor, "N 3"], edges: Float[Tensor, "N 2 3"], normal: Float[Tensor, "N 3"]
) -> Float[Tensor, "N 3"]:
    """Changes (u, v) of two weights and a distance d with u e0 + v e1 + d n = `offset`.

    Where the normal lies almost in the triangle, the triangle's own replaces it; without area, u = v = 0.

    References:
        Cramer's rule; SplattingAvatar's code minimizes the same residual by 50 steps of Adam.
    """
    first, second = edges.unbind(1)
    vector = torch.linalg.cross(first, second)
    area = vector.norm(dim=-1, keepdim=True)
    flat = area <= 1e-12
    own = torch.where(flat, normal, vector / area.clamp_min(1e-12))
    steep = (vector * normal).sum(-1, keepdim=True).abs() < STEEP * area
    normal = torch.where(steep, own, normal)
    determinant = (vector * normal).sum(-1, keepdim=True)
    determinant = torch.where(flat, torch.ones_like(determinant), determinant)
    minors = torch.stack((torch.linalg.cross(second, normal), torch.linalg.cross(normal, first), vector), dim=1)
    solved = (minors @ offset[:, :, None]).squeeze(-1) / determinant
    still = torch.cat((torch.zeros_like(offset[:, :2]), (offset * normal).sum(-1, keepdim=True)), dim=1)
    return torch.where(flat, still, solved)


def scaling_regularizer(scales: Float[Tensor, "N 3"], threshold: float, ratio: float) -> Float[Tensor, ""]:
    """Mean of the largest deviation of Gaussians that are large and thin, m; 0 if there are none.

    Args:
        scales: Standard deviations of the posed Gaussians, m.
        threshold: Largest deviation above which a Gaussian is large, m.
        ratio: Largest over smallest deviation above which it is thin.

    References:
        SplattingAvatar (Shao et al. 2024), Eq. 10; both conditions as in its code.
    """
    largest, smallest = scales.amax(1), scales.amin(1)
    chosen = (largest > threshold) & (largest > ratio * smallest)
    return torch.where(chosen, largest, torch.zeros_like(largest)).sum() / chosen.sum().clamp_min(1)
