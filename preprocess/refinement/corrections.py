"""What refinement may change: a few numbers a frame, and the tracking that they make of the tracked one.

The numbers are in units of what a good tracker gets wrong, so that one unit means about the same everywhere. Each has a
prior about the tracked value and a fastest motion.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from preprocess.refinement.neck import Neck
from preprocess.refinement.rigid_steps import stepped

DEGREE = np.pi / 180
CHANGED = ("world_to_camera", "expression", "joint_rotations", "eyelids", "torso_to_camera")
"""Arrays of a tracking that corrections change."""
JOINTS = ("jaw", "left_eye", "right_eye")
"""Joints that corrections turn."""
EXPRESSIONS = 16
"""Largest number of corrected expression components."""


@dataclass(frozen=True)
class Block:
    """Numbers of one kind.

    Attributes:
        name: What they correct.
        units: Of each number: rad, m or the tracked codes' unit.
        prior: Standard deviation about the tracked values, in these units.
        cutoff: Fastest motion of the correction that is kept, Hz.
    """

    name: str
    units: tuple[float, ...]
    prior: float
    cutoff: float


@dataclass(frozen=True)
class Corrections:
    """The corrections that a tracking allows, as arrays of C numbers a frame.

    Attributes:
        blocks: Kinds of numbers in their order.
        expressions: Expression codes per unit of each corrected component.
        pivot: Center of the shoulders in head space, m; where the torso turns.
        origins: Head's origin in the world, m.
        neck: Where the torso's motion is stored, if not in `torso_to_camera`.
        joints: Rows of jaw, left eye and right eye; −1 if the head has none.
    """

    blocks: tuple[Block, ...]
    expressions: Float[np.ndarray, "K E"]
    pivot: Float[np.ndarray, "3"]
    origins: Float[np.ndarray, "T 3"]
    neck: Neck | None
    joints: tuple[int, int, int]

    @property
    def count(self) -> int:
        """Numbers a frame."""
        return sum(len(block.units) for block in self.blocks)

    def at(self, row: int) -> Corrections:
        """The corrections of one frame, for a tracking of that row alone."""
        return dataclasses.replace(self, origins=self.origins[row : row + 1])

    def per_number(self, attribute: str) -> Float[np.ndarray, " C"]:
        """`prior` or `cutoff` of every number."""
        return np.concatenate([np.full(len(block.units), getattr(block, attribute)) for block in self.blocks])

    def split(self, values: Float[np.ndarray, "T C"]) -> dict[str, np.ndarray]:
        """The numbers by the name of their block, in rad, m and codes."""
        parts, first = {}, 0
        for block in self.blocks:
            last = first + len(block.units)
            parts[block.name] = values[:, first:last] * np.asarray(block.units)
            first = last
        return parts

    def moved(self, tracking: Tracking, values: Float[np.ndarray, "T C"]) -> Tracking:
        """The tracking with corrections applied to it; zero gives the tracking itself."""
        parts = self.split(values)
        views = stepped(tracking.world_to_camera, self.origins, parts["head"])
        expression, joints = tracking.expression.copy(), tracking.joint_rotations.copy()
        expression += parts["expression"] @ self.expressions
        jaw, *eyes = self.joints
        if "jaw" in parts:
            joints[:, jaw, :2] += parts["jaw"]
        if "gaze" in parts:
            joints[:, eyes, :2] += parts["gaze"][:, None]
        eyelids = tracking.eyelids + parts["eyelids"] if "eyelids" in parts else tracking.eyelids
        torso = tracking.torso_to_camera
        if self.neck is not None:
            before = tracking.world_to_camera @ self.neck.torso_in_head(tracking.expression, tracking.joint_rotations)
            pivots = np.broadcast_to(self.pivot, (len(views), 3))
            after = stepped(before, pivots, parts["torso"])
            expression, joints = self.neck.with_torso(expression, joints, views, after)
        elif torso is not None and "torso" in parts:
            torso = stepped(torso, np.broadcast_to(self.pivot, (len(views), 3)), parts["torso"])
        return dataclasses.replace(
            tracking,
            world_to_camera=views,
            expression=expression,
            joint_rotations=joints,
            eyelids=eyelids,
            torso_to_camera=torso,
        )

    def pulled_back(
        self, tracking: Tracking, values: Float[np.ndarray, "T C"], gradients: dict[str, np.ndarray], step: float = 1e-3
    ) -> Float[np.ndarray, "T C"]:
        """Gradient with respect to the corrections from that with respect to the arrays of the corrected tracking.

        The derivative of `moved` is taken by central differences, for all frames at once.

        Args:
            tracking: The tracked one.
            values: Corrections at which the gradients were taken.
            gradients: By name of the array.
            step: Of the differences, in units of the corrections.
        """
        result = np.zeros_like(values)
        for column in range(values.shape[1]):
            low, high = values.copy(), values.copy()
            low[:, column] -= step
            high[:, column] += step
            below, above = self.moved(tracking, low), self.moved(tracking, high)
            for name, gradient in gradients.items():
                change = (getattr(above, name) - getattr(below, name)) / (2 * step)
                result[:, column] += (change * gradient).reshape(len(values), -1).sum(axis=1)
        return result


def corrections_of(head: HeadModel, tracking: Tracking) -> Corrections:
    """The corrections that a head and its tracking allow."""
    neck = Neck.of(head)
    jaw, left, right = (head.joint_names.index(n) if n in head.joint_names else -1 for n in JOINTS)
    components = expression_components(head, tracking, neck is not None)
    pivot = neck.joints.lower if neck else (head.joint_regressor @ head.template)[0].double().numpy()
    turn, across, along = 0.5 * DEGREE, 0.001, 0.004
    blocks = [
        Block("head", (turn, turn, turn, across, across, along), 4.0, 4.0),
        Block("expression", (1.0,) * len(components), 0.5, 6.0),
    ]
    if neck is not None or tracking.torso_to_camera is not None:
        blocks.append(Block("torso", (turn, turn, turn, across, across, along), 4.0, 2.5))
    if jaw >= 0:
        blocks.append(Block("jaw", (DEGREE, DEGREE), 2.0, 6.0))
    if min(left, right) >= 0:
        blocks.append(Block("gaze", (2 * DEGREE, 2 * DEGREE), 2.0, 6.0))
    if bool(head.eyelid_basis.any()):
        blocks.append(Block("eyelids", (0.1, 0.1), 1.5, 9.0))
    return Corrections(
        tuple(blocks),
        components,
        pivot,
        head_origins(head, tracking),
        neck,
        (jaw, left, right),
    )


def head_origins(head: HeadModel, tracking: Tracking) -> Float[np.ndarray, "T 3"]:
    """Where the head's origin is in the world in every frame, m."""
    from ggavatar.data.frames import head_pose

    def origin(row: int) -> np.ndarray:
        joints, shift = (torch.tensor(part[row]).float() for part in (tracking.joint_rotations, tracking.translation))
        return head_pose(head, joints, shift)[:3, 3].double().numpy()

    return np.stack([origin(row) for row in range(len(tracking.expression))])


def expression_components(head: HeadModel, tracking: Tracking, has_neck: bool) -> Float[np.ndarray, "K E"]:
    """Expression codes of the clip's main components of motion on the mesh, one standard deviation each.

    Args:
        head: The head model.
        tracking: As tracked.
        has_neck: Whether the last code is the length of the neck, which belongs to the torso.
    """
    codes = tracking.expression - tracking.expression.mean(axis=0)
    if not codes.any():
        return np.zeros((0, codes.shape[1]))
    basis = head.expression_basis.double().numpy().reshape(-1, codes.shape[1]).copy()
    if has_neck:
        basis[:, -1] = 0.0
    values, vectors = np.linalg.eigh(basis.T @ basis)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    back = np.divide(
        1.0, np.sqrt(np.maximum(values, 1e-30)), where=values > 1e-12 * values.max(), out=np.zeros_like(values)
    )
    _, stds, directions = np.linalg.svd(codes @ root / np.sqrt(len(codes)), full_matrices=False)
    kept = min(EXPRESSIONS, int((stds > 0.02 * stds.max()).sum()))
    return stds[:kept, None] * (directions[:kept] * back) @ vectors.T
