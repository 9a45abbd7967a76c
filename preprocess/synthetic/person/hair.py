"""Growth of scalp hair on the generic head: combed, falling, clumped strands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import cKDTree

from ggavatar.head.procedural.surface import CHEEKS, JAW, NECK, SKULL, Primitive, skin_distance
from preprocess.synthetic.person.description import HairStyle
from preprocess.synthetic.person.skin_paint import scalp_coverage
from preprocess.synthetic.person.texture_space import noise

NODES = 14
"""Nodes per strand."""
_SHOULDERS = (
    Primitive((0.030, -0.150, -0.060), (0.165, -0.190, -0.055), (0.034, 0.042), 0.03),
    Primitive((0.0, -0.260, -0.050), (0.0, -0.300, -0.050), (0.080, 0.090), 0.03, (1.9, 1.0, 1.0)),
)
_OBSTACLES = (*SKULL, *NECK, *JAW, *CHEEKS, *_SHOULDERS)


@dataclass(frozen=True)
class ScalpHair:
    """Scalp hair at rest.

    Attributes:
        nodes: Positions from root to tip, head space, m.
        tone: Brightness factor of every strand.
        ambient_visibility: How much ambient light reaches every node, from 0 inside the hair to 1 outside.
    """

    nodes: Float[ndarray, "S N 3"]
    tone: Float[ndarray, " S"]
    ambient_visibility: Float[ndarray, "S N"]


def sample_surface(
    points: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    density: Float[ndarray, " F"],
    count: int,
    generator: np.random.Generator,
) -> tuple[Int[ndarray, " S"], Float[ndarray, "S 3"]]:
    """Random points on a mesh with the given relative density per area: faces and barycentric weights.

    Not `trimesh.sample.sample_surface`: its different draws would change the hair of every person.
    """
    corners = points[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    odds = area * density
    face = generator.choice(len(faces), count, p=odds / odds.sum())
    first, second = np.sqrt(generator.uniform(size=count)), generator.uniform(size=count)
    return face, np.stack((1 - first, first * (1 - second), first * second), axis=1)


def grow_scalp_hair(roots: Float[ndarray, "S 3"], hair: HairStyle, seed: int) -> ScalpHair:
    """Scalp hair from the given roots on the generic head, m."""
    generator = np.random.default_rng([seed, 3])
    count = len(roots)
    lengths = _lengths(roots, hair) * generator.uniform(0.78, 1.12, count)
    layer = generator.uniform(size=count) ** 0.8
    nodes = _march_strands(roots, lengths, layer, hair, generator)
    nodes = _clump(nodes, hair, generator)
    share = np.linspace(0, 1, NODES)
    ambient_visibility = np.clip(0.25 + 0.45 * layer[:, None] + 0.35 * share * (0.4 + 0.6 * layer[:, None]), 0, 1)
    tone = np.clip(1 + 0.22 * generator.standard_normal(count) + 0.18 * noise(roots, 0.02, seed + 9), 0.4, 1.8)
    return ScalpHair(nodes, tone, ambient_visibility)


def _lengths(roots: ndarray, hair: HairStyle) -> ndarray:
    """Length of every strand, m: separate for the fringe, and tapering to sides and nape in short cuts."""
    front = np.clip((roots[:, 2] - 0.005) / 0.03, 0, 1) * np.clip((roots[:, 1] - 0.05) / 0.02, 0, 1)
    length = hair.length + (hair.fringe - hair.length) * front
    if hair.length < 0.10:
        top = np.clip((roots[:, 1] - 0.045) / 0.055, 0, 1)
        length = length * (0.24 + 0.76 * top**1.3) * np.where((roots[:, 1] < 0.034) & (roots[:, 2] > -0.055), 0.55, 1.0)
    return length


def _combed(roots: ndarray, hair: HairStyle) -> ndarray:
    """Direction in which every strand is combed."""
    comb = np.tile(np.asarray(hair.comb), (len(roots), 1))
    if hair.part is not None:
        side = np.tanh((roots[:, 0] - hair.part) / 0.006)
        comb[:, 0] = np.abs(comb[:, 0]) * side
    return comb


def _gradient(points: ndarray) -> tuple[ndarray, ndarray]:
    """Distance to head, neck and shoulders, and its unit gradient."""
    step = 5e-4
    offsets = np.concatenate((np.zeros((1, 3)), step * np.eye(3)))
    values = skin_distance((points[None] + offsets[:, None]).reshape(-1, 3), _OBSTACLES).reshape(4, -1)
    gradient = (values[1:] - values[0]).T
    return values[0], gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)


def _march_strands(
    roots: ndarray, lengths: ndarray, layer: ndarray, hair: HairStyle, generator: np.random.Generator
) -> ndarray:
    """Nodes from root to tip: lifted off the skin, combed, pulled down, kept off head, shoulders and face."""
    _, normal = _gradient(roots)
    comb = _combed(roots, hair) + 0.16 * generator.standard_normal((len(roots), 3))
    comb -= (comb * normal).sum(axis=1, keepdims=True) * normal
    down = np.array([0.0, -1.0, 0.0]) + normal[:, 1:2] * normal
    comb += down * np.clip(0.6 - np.linalg.norm(comb, axis=1, keepdims=True), 0.0, 0.6)
    direction = hair.lift * (0.6 + 0.8 * layer[:, None]) * normal + (1 - 0.6 * hair.lift) * comb
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    nodes = [roots]
    step = (lengths / (NODES - 1))[:, None]
    margin = 0.0012 + 0.010 * layer * np.clip(hair.lift * 1.6, 0.2, 1)
    heavy = np.clip(lengths / 0.10, 0.15, 1)[:, None]
    for index in range(1, NODES):
        pull = 34.0 * step * heavy**2 * np.array([[0.0, -1.0, 0.0]]) + 9.0 * step * comb * (1 - 0.6 * heavy)
        direction = direction + pull + _away_from_face(nodes[-1]) * step * 15.0 * heavy
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        place = nodes[-1] + step * direction
        away, out = _gradient(place)
        need = np.maximum(margin * min(1.0, index / 3) - away, 0.0)
        place = place + need[:, None] * out
        direction = (place - nodes[-1]) / np.maximum(np.linalg.norm(place - nodes[-1], axis=1, keepdims=True), 1e-9)
        nodes.append(nodes[-1] + step * direction)
    return np.stack(nodes, axis=1)


def _away_from_face(points: ndarray) -> ndarray:
    """Direction that keeps hair out of the face: beside and below the eyes, outwards and behind the ears."""
    zone = np.clip((points[:, 2] + 0.004) / 0.02, 0, 1) * np.clip((0.085 - points[:, 1]) / 0.03, 0, 1)
    return zone[:, None] * np.stack(
        (0.75 * np.sign(points[:, 0]), np.zeros(len(points)), np.full(len(points), -0.75)), axis=1
    )


def _clump(nodes: ndarray, hair: HairStyle, generator: np.random.Generator) -> ndarray:
    """Strands pulled towards a few guide strands and curled with the phase of their clump."""
    leaders = generator.choice(len(nodes), min(max(40, len(nodes) // 32), len(nodes)), replace=False)
    _, clump = cKDTree(nodes[leaders, 0]).query(nodes[:, 0])
    leader = nodes[leaders[clump]]
    share = np.linspace(0, 1, NODES)[None, :, None]
    nodes = nodes + (leader - nodes) * 0.62 * share**0.8
    arc = np.linalg.norm(nodes[:, -1] - nodes[:, 0], axis=1)[:, None] * np.linspace(0, 1, NODES)
    phase = generator.uniform(0, 2 * np.pi, len(leaders))[clump] + 0.5 * generator.standard_normal(len(nodes))
    angle = 2 * np.pi * hair.wave * arc + phase[:, None]
    tangent = nodes[:, -1] - nodes[:, 0]
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    across = np.cross(tangent, (0.3, 0.2, 0.93))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    other = np.cross(tangent, across)
    radius = hair.curl * share[..., 0] ** 0.7 * generator.uniform(0.6, 1.2, len(nodes))[:, None]
    swing = radius[..., None] * (np.cos(angle)[..., None] * across[:, None] + np.sin(angle)[..., None] * other[:, None])
    return nodes + swing - swing[:, :1]


def scalp_density(centers: Float[ndarray, "F 3"], skin: ndarray) -> Float[ndarray, " F"]:
    """Relative hair density per area on the faces of the generic head; `skin` is 1 on the skin's faces, else 0."""
    return scalp_coverage(centers) * skin
