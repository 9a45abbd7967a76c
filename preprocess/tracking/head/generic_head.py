"""The generic head that is fitted to a tracked face: the procedural head with a torso, landmarks and neck joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry.landmark_embedding import (
    LandmarkEmbedding,
    boundary_loops,
    embed_landmarks,
    skin_faces,
)
from preprocess.tracking.head.expression_axes import generic_mixture

JOINT_NAMES = ("root", "neck", "jaw", "left_eye", "right_eye", "cervical", "torso")
PARENTS = (-1, 0, 1, 1, 1, 0, 5)
TORSO_RINGS = 7
"""Rings of vertices of the torso."""
TORSO_HALF_WIDTH, TORSO_HALF_DEPTH, TORSO_DROP = 0.215, 0.105, 0.24
"""Size of the torso below the head's shoulders, m."""
UV_STRIP = 0.10
"""Share of the texture, at its lower edge, that the torso occupies."""


@dataclass(frozen=True)
class GenericHead:
    """Arrays of the generic head and its landmark embedding.

    Attributes:
        head: The procedural head.
        vertices: Its vertices, then those of the torso, m.
        faces: All triangles.
        uv: Texture coordinates of every corner.
        soft: Triangles of skin and mouth lining, which deform smoothly.
        regions: Named vertex sets.
        landmarks: Sparse map from vertex values to values of the 468 landmarks.
        embedding: The same map as triangles and weights.
        weights: Skinning weights for `JOINT_NAMES`.
        joints: Positions of the joints, m.
        axes: Displacement per unit of the named expression axes, m.
    """

    head: HeadModel
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    uv: Float[np.ndarray, "F 3 2"]
    soft: Int[np.ndarray, "S 3"]
    regions: dict[str, np.ndarray]
    landmarks: csr_array
    embedding: LandmarkEmbedding
    weights: Float[np.ndarray, "V J"]
    joints: Float[np.ndarray, "J 3"]
    axes: Float[np.ndarray, "V 3 A"]


def generic_head(face: CanonicalFace) -> GenericHead:
    """Assemble the generic head; takes about five seconds."""
    head = procedural_head()
    embedding = embed_landmarks(face, head)
    upper = head.template.numpy().astype(np.float64)
    rim = _rim(head, upper)
    rings, torso_faces, torso_uv = _torso(upper[rim], rim, len(upper))
    vertices, faces = np.concatenate((upper, rings)), np.concatenate((head.faces.numpy(), torso_faces))
    regions = {name: rows.numpy() for name, rows in head.regions.items()}
    regions["torso"] = np.arange(len(upper), len(vertices))
    skin_and_bag = np.concatenate((regions["skin"], regions["mouth_bag"]))
    axes = np.zeros((len(vertices), 3, generic_mixture().shape[1]))
    axes[: len(upper)] = head.expression_basis.numpy().astype(np.float64) @ generic_mixture()
    return GenericHead(
        head=head,
        vertices=vertices,
        faces=faces,
        uv=np.concatenate((_shrunk_uv(head, len(head.faces)), torso_uv)),
        soft=head.faces.numpy()[np.isin(head.faces.numpy(), skin_and_bag).all(axis=1)],
        regions=regions,
        landmarks=embedding.matrix(len(vertices)),
        embedding=embedding,
        weights=_weights(head, vertices),
        joints=_joints(head, upper),
        axes=axes,
    )


def _shrunk_uv(head: HeadModel, count: int) -> np.ndarray:
    """The head's texture coordinates, scaled to leave the torso's strip free."""
    if head.uv is None:
        return np.zeros((count, 3, 2))
    return head.uv.numpy() * [1.0, 1.0 - UV_STRIP] + [0.0, UV_STRIP]


def _joints(head: HeadModel, upper: np.ndarray) -> np.ndarray:
    """The head's joints, then the upper neck joint at its neck joint and the lower one at its root."""
    own = head.joint_regressor.numpy().astype(np.float64) @ upper
    return np.concatenate((own, own[[1, 0]]))


def _rim(head: HeadModel, upper: np.ndarray) -> np.ndarray:
    """Vertices of the lower edge of the shoulders, in order."""
    return min(boundary_loops(skin_faces(head)), key=lambda loop: upper[loop, 1].mean())


def _torso(rim: np.ndarray, rows: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rings that widen from the rim to a torso: vertices, triangles and texture coordinates."""
    center = rim.mean(axis=0)
    heading = np.arctan2(rim[:, 2] - center[2], rim[:, 0] - center[0])
    wide = center + np.stack(
        (TORSO_HALF_WIDTH * np.cos(heading), np.zeros_like(heading), TORSO_HALF_DEPTH * np.sin(heading)), axis=1
    )
    share = np.arange(1, TORSO_RINGS + 1)[:, None, None] / TORSO_RINGS
    spread = np.sin(share * np.pi / 2)
    rings = (1 - spread) * rim + spread * wide - [0.0, TORSO_DROP, 0.0] * (share**1.6)
    grid = np.concatenate((rows[None], count + np.arange(TORSO_RINGS * len(rim)).reshape(TORSO_RINGS, -1)))
    here, there = grid[:-1], grid[1:]
    next_here, next_there = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    faces = np.concatenate(
        (
            np.stack((next_here, here, there), -1).reshape(-1, 3),
            np.stack((next_here, there, next_there), -1).reshape(-1, 3),
        )
    )
    u = np.tile(np.linspace(0.005, 0.995, len(rim) + 1), (TORSO_RINGS + 1, 1))
    v = np.repeat(np.linspace(UV_STRIP - 0.005, 0.005, TORSO_RINGS + 1)[:, None], len(rim) + 1, axis=1)
    uv = np.stack((u, v), axis=-1)
    first = np.stack((uv[:-1, 1:], uv[:-1, :-1], uv[1:, :-1]), axis=2).reshape(-1, 3, 2)
    second = np.stack((uv[:-1, 1:], uv[1:, :-1], uv[1:, 1:]), axis=2).reshape(-1, 3, 2)
    return rings.reshape(-1, 3), faces, np.concatenate((first, second))


def _weights(head: HeadModel, vertices: np.ndarray) -> np.ndarray:
    """Skinning weights: the head's, with the torso joint in place of the root; the upper neck joint has none."""
    own = head.skinning_weights.numpy().astype(np.float64)
    weights = np.zeros((len(vertices), len(JOINT_NAMES)))
    weights[: len(own), 1:5] = own[:, 1:]
    weights[: len(own), 6] = own[:, 0]
    weights[len(own) :, 6] = 1.0
    return weights
