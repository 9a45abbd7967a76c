"""Brows, lashes and beards: short strands that ride on the triangles of the moving skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from preprocess.subject.hair import scatter
from preprocess.subject.person import Person
from preprocess.subject.skin_paint import beard_share, brow_share
from preprocess.subject.texture_space import bump, noise, to_linear

NODES = 5


@dataclass(frozen=True)
class Fuzz:
    """Strands in the frames of triangles.

    Attributes:
        faces: Corners of the triangle under each strand.
        weights: Barycentric weights of the roots.
        local: Nodes relative to the root, in (first edge, second axis, normal), m.
        colors: Linear colour.
        widths: Width at the root, m.
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
    """Root positions and orthonormal frames (rows: along the first edge, across it, normal)."""
    corners = points[faces]
    along = corners[:, 1] - corners[:, 0]
    normal = np.cross(along, corners[:, 2] - corners[:, 0])
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.einsum("sk,skc->sc", weights, corners), np.stack((along, np.cross(normal, along), normal), axis=1)


def _attach(points: ndarray, faces: ndarray, place: tuple[ndarray, ndarray], offsets: ndarray, colors: ndarray, widths: ndarray) -> Fuzz:
    """Strands whose nodes are given as offsets from their roots at rest, [S, N, 3], m."""
    corners, weights = faces[place[0]], place[1]
    _, axes = _frames(points, corners, weights)
    return Fuzz(corners, weights, np.einsum("snc,skc->snk", offsets, axes), colors, widths)


def brows(points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], skin: ndarray, person: Person, seed: int) -> Fuzz:
    """Eyebrows: hairs that lie along the brow, rising at its inner end."""
    generator = np.random.default_rng([seed, 4])
    centers = points[faces].mean(axis=1)
    count = int(900 * person.brow_weight)
    place = scatter(points, faces, brow_share(centers) * skin, count, generator)
    root = np.einsum("sk,skc->sc", place[1], points[faces[place[0]]])
    outwards = np.clip((np.abs(root[:, 0]) - 0.010) / 0.035, 0, 1)
    heading = np.stack((np.sign(root[:, 0]) * (0.35 + 0.65 * outwards), 0.85 - 1.15 * outwards, 0.25 - 0.5 * outwards), axis=1)
    heading += 0.14 * generator.standard_normal(heading.shape)
    length = generator.uniform(0.0045, 0.0080, count)
    return _attach(points, faces, place, _arcs(heading, length, points, faces, place, 0.10), _tones(person.brow, count, generator), np.full(count, 0.00016))


def beard(points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], skin: ndarray, person: Person, seed: int) -> Fuzz | None:
    """A beard of short curly hairs that point down and away from the skin; None without one."""
    if person.beard is None:
        return None
    generator = np.random.default_rng([seed, 5])
    centers = points[faces].mean(axis=1)
    place = scatter(points, faces, beard_share(centers) * skin, person.beard.strands, generator)
    root = np.einsum("sk,skc->sc", place[1], points[faces[place[0]]])
    heading = np.stack((0.25 * np.sign(root[:, 0]), np.full(len(root), -0.9), np.full(len(root), 0.2)), axis=1)
    heading += 0.35 * generator.standard_normal(heading.shape)
    chin = bump(root, (0.0, -0.080, 0.045), (0.03, 0.02, 0.04))
    length = person.beard.length * generator.uniform(0.45, 1.0, len(root)) * (0.65 + 0.7 * chin)
    offsets = _arcs(heading, length, points, faces, place, 0.55)
    share = np.linspace(0, 1, NODES)[None, :, None]
    wind = np.stack([noise(root + 0.0015 * k, 0.003, seed + k) for k in range(3)], axis=1)
    offsets = offsets + 0.0022 * np.sin(5.5 * share + 3 * wind[:, None]) * share * wind[:, None]
    return _attach(points, faces, place, offsets, _tones(person.beard.color, len(root), generator), np.full(len(root), 0.00013))


def lashes(points: Float[ndarray, "V 3"], loops: tuple[ndarray, ndarray], faces: Int[ndarray, "F 3"], person: Person, seed: int) -> Fuzz:
    """Upper and lower lashes along the lid margins, fanned outwards and curved up."""
    generator = np.random.default_rng([seed, 6])
    parts: list[tuple[int, float, float]] = []
    for side, loop in enumerate(loops):
        for index in range(len(loop)):
            angle = 2 * np.pi * index / len(loop)
            upper = 0 < index < len(loop) // 2
            parts += [(side, angle, share) for share in np.linspace(0, 1, 6 if upper else 3, endpoint=False)]
    side, angle, share = (np.asarray(values) for values in zip(*parts, strict=True))
    size = len(loops[0])
    index = np.round(angle * size / (2 * np.pi)).astype(int) % size
    first = np.where(side == 0, loops[0][index], loops[1][index])
    second = np.where(side == 0, loops[0][(index + 1) % size], loops[1][(index + 1) % size])
    owner = _faces_with_edge(faces, first, second)
    corners = faces[owner]
    weights = (corners == first[:, None]) * (1 - share[:, None]) + (corners == second[:, None]) * share[:, None]
    sign = np.where(side == 0, 1.0, -1.0)
    upper = (angle > 0) & (angle < np.pi)
    heading = np.stack((0.75 * np.cos(angle) * sign, np.where(upper, 0.15, -0.45), np.full(len(sign), 0.9)), axis=1)
    heading += 0.10 * generator.standard_normal(heading.shape)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    length = np.where(upper, 0.0075, 0.0035) * generator.uniform(0.75, 1.1, len(sign)) * np.clip(0.5 + 0.55 * np.abs(np.sin(angle)), 0, 1)
    along = np.linspace(0, 1, NODES)[None, :, None]
    rise = np.where(upper, 0.85, -0.25)[:, None, None] * np.array([0.0, 1.0, 0.0])
    offsets = length[:, None, None] * (along * heading[:, None] + along**2 * rise * 0.6) * min(1.15, 0.6 + 0.5 * person.lashes)
    colors = _tones(tuple(0.6 * value for value in person.brow), len(sign), generator)
    return _attach(points, faces, (owner, weights), offsets, colors, np.full(len(sign), 0.00013 + 0.00007 * person.lashes))


def _faces_with_edge(faces: ndarray, first: ndarray, second: ndarray) -> ndarray:
    """For every vertex pair, a face that has both."""
    count = int(faces.max()) + 1
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    keys = np.sort(edges, axis=1) @ np.array([count, 1])
    order = np.argsort(keys, kind="stable")
    wanted = np.sort(np.stack((first, second), axis=1), axis=1) @ np.array([count, 1])
    return order[np.searchsorted(keys[order], wanted)] % len(faces)


def _arcs(heading: ndarray, length: ndarray, points: ndarray, faces: ndarray, place: tuple[ndarray, ndarray], lift: float) -> ndarray:
    """Offsets of strands that start along `heading` in the skin's plane, raised by `lift`, and bend back towards the skin."""
    _, axes = _frames(points, faces[place[0]], place[1])
    normal = axes[:, 2]
    flat = heading - (heading * normal).sum(axis=1, keepdims=True) * normal
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    along = np.linspace(0, 1, NODES)[None, :, None]
    return length[:, None, None] * (along * flat[:, None] + (lift + 0.35) * along * (1 - 0.55 * along) * normal[:, None])


def _tones(color: tuple[float, float, float], count: int, generator: np.random.Generator) -> ndarray:
    """Linear colours scattered in brightness around an sRGB one."""
    return to_linear(np.asarray(color) * np.clip(1 + 0.25 * generator.standard_normal((count, 1)), 0.4, 1.7))
