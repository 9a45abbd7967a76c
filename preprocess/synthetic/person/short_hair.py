"""Short hair (brows and beards): strands attached to the triangles of the moving skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from preprocess.synthetic.person.description import Person
from preprocess.synthetic.person.hair import sample_surface
from preprocess.synthetic.person.skin_paint import beard_coverage, brow_coverage
from preprocess.synthetic.person.texture_space import mirrored_gaussian, noise, to_linear

NODES = 5


@dataclass(frozen=True)
class ShortHair:
    """Strands in the local frames of triangles.

    Attributes:
        faces: Corners of the triangle under each strand.
        weights: Barycentric weights of the roots.
        local: Nodes relative to the root in the triangle frame (first edge, across it, normal), m.
        colors: Linear color of each strand.
        widths: Width of each strand at the root, m.
    """

    faces: Int[ndarray, "S 3"]
    weights: Float[ndarray, "S 3"]
    local: Float[ndarray, "S N 3"]
    colors: Float[ndarray, "S 3"]
    widths: Float[ndarray, " S"]

    def posed(self, points: Float[ndarray, "V 3"]) -> Float[ndarray, "S N 3"]:
        """Nodes on the posed skin, m."""
        root, axes = _frames(points, self.faces, self.weights)
        return root[:, None] + np.einsum("snk,skc->snc", self.local, axes)


def _frames(points: ndarray, faces: ndarray, weights: ndarray) -> tuple[ndarray, ndarray]:
    """Root positions and orthonormal triangle frames (rows: along the first edge, across it, normal)."""
    corners = points[faces]
    along = corners[:, 1] - corners[:, 0]
    normal = np.cross(along, corners[:, 2] - corners[:, 0])
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.einsum("sk,skc->sc", weights, corners), np.stack((along, np.cross(normal, along), normal), axis=1)


def attach(
    points: ndarray, faces: ndarray, place: tuple[ndarray, ndarray], offsets: ndarray, colors: ndarray, widths: ndarray
) -> ShortHair:
    """Strands attached to a mesh at rest.

    Args:
        points: Vertices at rest [V, 3], m.
        faces: Triangles [F, 3].
        place: Face [S] and barycentric weights [S, 3] of every root.
        offsets: Nodes relative to the roots [S, N, 3], m.
        colors: Linear color of each strand [S, 3].
        widths: Width of each strand at the root [S], m.
    """
    corners, weights = faces[place[0]], place[1]
    _, axes = _frames(points, corners, weights)
    return ShortHair(corners, weights, np.einsum("snc,skc->snk", offsets, axes), colors, widths)


def brows(
    points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], skin: ndarray, person: Person, seed: int
) -> ShortHair:
    """Eyebrows: strands along the brow that rise at its inner end."""
    generator = np.random.default_rng([seed, 4])
    centers = points[faces].mean(axis=1)
    count = int(900 * person.brow_weight)
    place = sample_surface(points, faces, brow_coverage(centers) * skin, count, generator)
    root = np.einsum("sk,skc->sc", place[1], points[faces[place[0]]])
    outwards = np.clip((np.abs(root[:, 0]) - 0.010) / 0.035, 0, 1)
    heading = np.stack(
        (np.sign(root[:, 0]) * (0.35 + 0.65 * outwards), 0.85 - 1.15 * outwards, 0.25 - 0.5 * outwards), axis=1
    )
    heading += 0.14 * generator.standard_normal(heading.shape)
    length = generator.uniform(0.0045, 0.0080, count)
    return attach(
        points,
        faces,
        place,
        _arcs(heading, length, points, faces, place, 0.10),
        hair_colors(person.brow, count, generator),
        np.full(count, 0.00016),
    )


def beard(
    points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], skin: ndarray, person: Person, seed: int
) -> ShortHair | None:
    """A beard of short curly strands that point down and away from the skin; None for a person without one."""
    if person.beard is None:
        return None
    generator = np.random.default_rng([seed, 5])
    centers = points[faces].mean(axis=1)
    place = sample_surface(points, faces, beard_coverage(centers) * skin, person.beard.strands, generator)
    root = np.einsum("sk,skc->sc", place[1], points[faces[place[0]]])
    heading = np.stack((0.25 * np.sign(root[:, 0]), np.full(len(root), -0.9), np.full(len(root), 0.2)), axis=1)
    heading += 0.35 * generator.standard_normal(heading.shape)
    chin = mirrored_gaussian(root, (0.0, -0.080, 0.045), (0.03, 0.02, 0.04))
    length = person.beard.length * generator.uniform(0.45, 1.0, len(root)) * (0.65 + 0.7 * chin)
    offsets = _arcs(heading, length, points, faces, place, 0.55)
    share = np.linspace(0, 1, NODES)[None, :, None]
    wind = np.stack([noise(root + 0.0015 * k, 0.003, seed + k) for k in range(3)], axis=1)
    offsets = offsets + 0.0022 * np.sin(5.5 * share + 3 * wind[:, None]) * share * wind[:, None]
    return attach(
        points,
        faces,
        place,
        offsets,
        hair_colors(person.beard.color, len(root), generator),
        np.full(len(root), 0.00013),
    )


def _arcs(
    heading: ndarray, length: ndarray, points: ndarray, faces: ndarray, place: tuple[ndarray, ndarray], lift: float
) -> ndarray:
    """Node offsets of strands that start along `heading` in the skin's plane, raised by `lift`, and bend back to it."""
    _, axes = _frames(points, faces[place[0]], place[1])
    normal = axes[:, 2]
    flat = heading - (heading * normal).sum(axis=1, keepdims=True) * normal
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    along = np.linspace(0, 1, NODES)[None, :, None]
    return length[:, None, None] * (
        along * flat[:, None] + (lift + 0.35) * along * (1 - 0.55 * along) * normal[:, None]
    )


def hair_colors(color: tuple[float, float, float], count: int, generator: np.random.Generator) -> ndarray:
    """Linear colors of strands, varied in brightness around an sRGB color."""
    return to_linear(np.asarray(color) * np.clip(1 + 0.25 * generator.standard_normal((count, 1)), 0.4, 1.7))
