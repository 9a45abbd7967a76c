"""Posing of one frame: the head model plus sticky lips, bulges and neck twist, which the head model cannot express."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.expression import lower_lip_weight
from ggavatar.head.procedural.model import procedural_names
from preprocess.synthetic.animation.performance import Performance
from preprocess.synthetic.person.character import Character
from preprocess.synthetic.person.texture_space import smoothstep
from preprocess.synthetic.person.wrinkles import bulge_strengths

_STUCK, _FREE = 0.0004, 0.0030


def tracked_vertices(head: HeadModel, performance: Performance, index: int) -> Float[ndarray, "V 3"]:
    """The head model's vertices in one frame, head space, m."""
    rotations = torch.zeros(len(head.parents), 3)
    rotations[head.joint_index("jaw")] = torch.from_numpy(performance.jaw[index])
    rotations[head.joint_index("left_eye")] = torch.from_numpy(performance.eyes[index, 0])
    rotations[head.joint_index("right_eye")] = torch.from_numpy(performance.eyes[index, 1])
    drive = dataclasses.replace(
        head.neutral_drive(),
        expression=torch.from_numpy(performance.expression[index]).float(),
        joint_rotations=rotations,
        eyelids=torch.from_numpy(performance.eyelids[index]).float(),
    )
    with torch.no_grad():
        return head.vertices(drive).numpy().astype(np.float64)


@dataclass(frozen=True)
class StickyLips:
    """Lips that stick together: pairs of vertices on the lip margin, and the vertices that follow each pair.

    Attributes:
        upper: Upper vertex of each pair.
        lower: Lower vertex of each pair.
        cling: How strongly each pair sticks, from 0.25 in the middle to 1 at the corners.
        vertices: Vertices that follow a pair.
        pair: The pair that each of them follows.
        weight: How much each of them follows; negative on the lower lip.
    """

    upper: ndarray
    lower: ndarray
    cling: ndarray
    vertices: ndarray
    pair: ndarray
    weight: ndarray

    def apply(self, points: Float[ndarray, "V 3"]) -> Float[ndarray, "V 3"]:
        """Vertices with small gaps between the lips closed, up to 3 mm near the corners, as moist lips do."""
        gap = points[self.upper] - points[self.lower]
        size = np.linalg.norm(gap, axis=1)
        hold = 1 - smoothstep(0.0, 1.0, (size - _STUCK) / (self.cling * (_FREE - _STUCK) + 1e-6))
        pull = 0.5 * gap * hold[:, None]
        moved = points.copy()
        sign = np.where(self.weight > 0, -1.0, 1.0)
        moved[self.vertices] += (sign * np.abs(self.weight))[:, None] * pull[self.pair]
        return moved


def sticky_lips(head: HeadModel, generic: Float[ndarray, "V 3"]) -> StickyLips:
    """Sticky lips of a head; `generic` are the vertices of the generic head, m."""
    loop = head.regions["lip_margin"].numpy()
    half = len(loop) // 2
    upper, lower = loop[1:half], loop[:half:-1]
    across = np.abs(generic[upper, 0]) / np.abs(generic[loop, 0]).max()
    skin = np.concatenate((head.regions["skin"].numpy(), head.regions["mouth_bag"].numpy()))
    near = skin[np.abs(generic[skin] - generic[loop].mean(axis=0)).max(axis=1) < 0.030]
    away, pair = cKDTree(generic[upper]).query(generic[near])
    below = lower_lip_weight(generic[near]) > 0.5
    below |= np.isin(near, lower)
    below &= ~np.isin(near, upper)
    weight = np.exp(-((away / 0.0032) ** 2)) * np.where(below, -1.0, 1.0)
    kept = np.abs(weight) > 0.02
    pair = np.asarray(pair)
    return StickyLips(upper, lower, 0.25 + 0.75 * across**3, near[kept], pair[kept], weight[kept])


@dataclass(frozen=True)
class PosedGeometry:
    """Posed geometry of one frame.

    Attributes:
        head: Vertices of the head in the room, m.
        torso: Vertices of the garment, m.
        accessory: Vertices of glasses or hat, m.
        lens: Vertices of the lenses, m.
        values: Expression coefficients by name.
        mouth_open: Mean gap between the lips, m.
    """

    head: Float[ndarray, "W 3"]
    torso: Float[ndarray, "A 3"]
    accessory: Float[ndarray, "B 3"]
    lens: Float[ndarray, "C 3"]
    values: dict[str, float]
    mouth_open: float


def pose_character(character: Character, lips: StickyLips, performance: Performance, index: int) -> PosedGeometry:
    """The person's geometry in one frame of a performance."""
    values = dict(zip(procedural_names()[0], performance.expression[index].tolist(), strict=True))
    tracked = lips.apply(tracked_vertices(character.head, performance, index))
    fine = character.fine.weights @ tracked
    fine = fine + np.einsum("bs,bsvc->vc", bulge_strengths(values), character.bulges)
    opening = float(np.linalg.norm(tracked[lips.upper] - tracked[lips.lower], axis=1).mean())
    head, torso = performance.head_to_room[index], performance.torso_to_room[index]
    return PosedGeometry(
        head=_twisted(fine, character.rest[:, 1], head, torso),
        torso=_moved(character.torso.points, torso),
        accessory=_moved(character.accessory.points, head),
        lens=_moved(character.lens.points, head),
        values=values,
        mouth_open=opening,
    )


def _moved(points: ndarray, transform: ndarray) -> ndarray:
    return points @ transform[:3, :3].T + transform[:3, 3]


def _twisted(points: ndarray, height: ndarray, head: ndarray, torso: ndarray) -> ndarray:
    """Head pose above, torso pose below, and in between a neck that takes part of the relative rotation."""
    share = smoothstep(-0.158, -0.072, height)
    between = np.linalg.inv(torso) @ head
    turn = Rotation.from_matrix(between[:3, :3]).as_rotvec()
    middle = (share > 0) & (share < 1)
    moved = np.where((share >= 1)[:, None], _moved(points, between), points)
    rotations = Rotation.from_rotvec(share[middle, None] * turn).as_matrix()
    pivot = np.array([0.0, -0.11, -0.045])
    shift = between[:3, 3] - (pivot - between[:3, :3] @ pivot)
    moved[middle] = np.einsum("nij,nj->ni", rotations, points[middle] - pivot) + pivot + share[middle, None] * shift
    return _moved(moved, torso)
