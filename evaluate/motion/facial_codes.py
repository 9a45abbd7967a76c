"""The part of a driving sequence that moves the face, as the columns of one matrix: expression, jaw, eyes, lids."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluate.motion.driving_sequence import DrivingSequence
from ggavatar.head.expression_axes import NECK_LENGTH, is_shared

_JOINT_COMPONENTS = {"jaw": 3, "left_eye": 2, "right_eye": 2}
"""Components of the rotation vector that are codes; an eye does not roll."""


@dataclass(frozen=True)
class FacialLayout:
    """Which values of a driving sequence are facial codes, in the order of the columns.

    Attributes:
        names: Of the columns.
        shared: Whether a column means the same for every sequence that has one of its name.
        zero_is_rest: Whether expressions of zero are the person's face at rest; FLAME's zero is another face.
        expressions: Columns of `DrivingSequence.expression`.
        joints: Joint and component of every rotation.
    """

    names: tuple[str, ...]
    shared: tuple[bool, ...]
    zero_is_rest: bool
    expressions: tuple[int, ...]
    joints: tuple[tuple[int, int], ...]

    def columns(self, prefix: str) -> np.ndarray:
        """The columns whose name begins so."""
        return np.flatnonzero([name.startswith(prefix) for name in self.names])


def facial_layout(sequence: DrivingSequence) -> FacialLayout:
    """The facial codes of a sequence; the neck's length moves no face and is left out."""
    axes = sequence.axis_names or tuple(f"{sequence.head_version} {i}" for i in range(sequence.expression.shape[1]))
    expressions = tuple(i for i, name in enumerate(axes) if name != NECK_LENGTH)
    joints = tuple(
        (sequence.joint_names.index(name), component)
        for name, count in _JOINT_COMPONENTS.items()
        if name in sequence.joint_names
        for component in range(count)
    )
    names = [axes[i] for i in expressions]
    names += [f"joint {sequence.joint_names[joint]} {component}" for joint, component in joints]
    names += ["lid left", "lid right"]
    shared = tuple(is_shared(name) for name in names)
    return FacialLayout(tuple(names), shared, bool(sequence.axis_names), expressions, joints)


def facial_codes(sequence: DrivingSequence, layout: FacialLayout) -> Float[np.ndarray, "T K"]:
    """The facial codes of every frame."""
    rotations = [sequence.joint_rotations[:, joint, component] for joint, component in layout.joints]
    return np.column_stack((sequence.expression[:, list(layout.expressions)], *rotations, sequence.eyelids))


def with_facial_codes(
    sequence: DrivingSequence, layout: FacialLayout, codes: Float[np.ndarray, "T K"]
) -> DrivingSequence:
    """The sequence with other facial codes."""
    count = len(layout.expressions)
    expression, rotations = sequence.expression.copy(), sequence.joint_rotations.copy()
    expression[:, list(layout.expressions)] = codes[:, :count]
    for column, (joint, component) in enumerate(layout.joints, start=count):
        rotations[:, joint, component] = codes[:, column]
    return dataclasses.replace(sequence, expression=expression, joint_rotations=rotations, eyelids=codes[:, -2:])
