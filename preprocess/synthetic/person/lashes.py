"""Upper and lower lashes along the lid margins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from preprocess.synthetic.person.description import Person
from preprocess.synthetic.person.short_hair import NODES, ShortHair, attach, hair_colors

_UPPER, _LOWER = 6, 3


@dataclass(frozen=True)
class _Roots:
    """Roots of lashes.

    Attributes:
        first: First vertex of the margin edge that each lash stands on.
        second: Second vertex of that edge.
        share: Position along the edge, from 0 to 1.
        angle: Angle around the eye's opening, rad.
        side: +1 for the left eye, −1 for the right.
    """

    first: ndarray
    second: ndarray
    share: ndarray
    angle: ndarray
    side: ndarray

    @property
    def upper(self) -> ndarray:
        """Whether each lash belongs to the upper lid."""
        return np.sin(self.angle) > 1e-9


def lashes(
    points: Float[ndarray, "V 3"], loops: tuple[ndarray, ndarray], faces: Int[ndarray, "F 3"], person: Person, seed: int
) -> ShortHair:
    """Lashes that fan outwards and curve up.

    Args:
        points: Vertices at rest, m.
        loops: Lid margins of the left and the right eye, from the outer corner over the upper lid.
        faces: Triangles of the skin.
        person: Gives color and fullness.
        seed: Seed of the variation.
    """
    generator = np.random.default_rng([seed, 6])
    roots = _roots(loops)
    owner = _faces_with_edge(faces, roots.first, roots.second)
    corners = faces[owner]
    share = roots.share[:, None]
    weights = (corners == roots.first[:, None]) * (1 - share) + (corners == roots.second[:, None]) * share
    color = (0.6 * person.brow[0], 0.6 * person.brow[1], 0.6 * person.brow[2])
    offsets = _curves(roots, generator) * min(1.15, 0.6 + 0.5 * person.lashes)
    widths = np.full(len(share), 0.00013 + 0.00007 * person.lashes)
    return attach(points, faces, (owner, weights), offsets, hair_colors(color, len(share), generator), widths)


def _roots(loops: tuple[ndarray, ndarray]) -> _Roots:
    """Roots on every edge of both margins, more on the upper lid."""
    parts = []
    for side, loop in zip((1.0, -1.0), loops, strict=True):
        for index in range(len(loop)):
            count = _UPPER if 0 < index < len(loop) // 2 else _LOWER
            share = np.arange(count) / count
            edge = np.tile((loop[index], loop[(index + 1) % len(loop)]), (count, 1))
            angle = np.full(count, 2 * np.pi * index / len(loop))
            parts.append((edge[:, 0], edge[:, 1], share, angle, np.full(count, side)))
    return _Roots(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _curves(roots: _Roots, generator: np.random.Generator) -> Float[ndarray, "S N 3"]:
    """Offsets of the nodes from the roots, m."""
    count = len(roots.share)
    rise = np.where(roots.upper, 0.15, -0.45)
    heading = np.stack((0.75 * np.cos(roots.angle) * roots.side, rise, np.full(count, 0.9)), axis=1)
    heading += 0.10 * generator.standard_normal(heading.shape)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    fuller = np.clip(0.5 + 0.55 * np.abs(np.sin(roots.angle)), 0, 1)
    length = np.where(roots.upper, 0.0075, 0.0035) * generator.uniform(0.75, 1.1, count) * fuller
    along = np.linspace(0, 1, NODES)[None, :, None]
    bend = np.where(roots.upper, 0.51, -0.15)[:, None, None] * np.array([0.0, 1.0, 0.0])
    return length[:, None, None] * (along * heading[:, None] + along**2 * bend)


def _faces_with_edge(faces: ndarray, first: ndarray, second: ndarray) -> ndarray:
    """For every vertex pair, a face that contains both."""
    count = int(faces.max()) + 1
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    keys = np.sort(edges, axis=1) @ np.array([count, 1])
    order = np.argsort(keys, kind="stable")
    wanted = np.sort(np.stack((first, second), axis=1), axis=1) @ np.array([count, 1])
    return order[np.searchsorted(keys[order], wanted)] % len(faces)
