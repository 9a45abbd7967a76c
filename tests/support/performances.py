"""Driving sequences with random motion, and persons whose faces have known scores."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from evaluate.motion.driving_sequence import Cameras, DrivingSequence
from evaluate.motion.face import SCORES
from tests.support.toy_run import JOINTS


def motion(seed: int, count: int = 12, depth: float = 1.0, width: int = 100) -> DrivingSequence:
    """Random head parameters and cameras."""
    random = np.random.default_rng(seed)
    views = np.repeat(np.eye(4)[None], count, 0)
    views[:, :3, :3] = Rotation.from_rotvec(random.normal(0, 0.3, (count, 3))).as_matrix()
    views[:, :3, 3] = random.normal([0, 0, depth], 0.05, (count, 3))
    intrinsics = np.repeat(np.diag([200.0, 200.0, 1.0])[None], count, 0)
    return DrivingSequence(
        expression=random.normal(size=(count, 4)),
        joint_rotations=random.normal(0, 0.2, (count, 5, 3)),
        eyelids=random.random((count, 2)),
        translation=random.normal(0, 0.01, (count, 3)),
        cameras=Cameras(views, intrinsics, (width, width)),
        frames=tuple(range(5, 5 + count)),
        fps=25.0,
        joint_names=JOINTS,
        head_version="toy-1",
    )


@dataclasses.dataclass(frozen=True)
class Person:
    """A made-up person: expression axes in an order of their own, and a face whose scores are known.

    The logits of the scores are linear in the codes, as `offset + slopes · codes`.
    """

    axis_names: tuple[str, ...]
    slopes: np.ndarray
    offset: np.ndarray

    def scores(self, expression: np.ndarray) -> np.ndarray:
        """The 52 scores of expressions."""
        shown = expit(self.offset + expression @ self.slopes.T)
        return np.concatenate((np.zeros((len(shown), 1)), shown), axis=1)

    def perform(self, expression: np.ndarray) -> DrivingSequence:
        """A sequence with these expressions, nothing else moving, and its scores."""
        still = motion(0, len(expression))
        return dataclasses.replace(
            still,
            expression=expression,
            joint_rotations=np.zeros((len(expression), 5, 3)),
            eyelids=np.zeros((len(expression), 2)),
            axis_names=self.axis_names,
            scores=self.scores(expression),
        )


def person(seed: int, named: tuple[str, ...], own: int) -> Person:
    """A person with named axes, which move the scores of their names, and axes of their own, which move a mixture."""
    random = np.random.default_rng(seed)
    names = [*named, *(f"own{number + 1}" for number in range(own))]
    order = random.permutation(len(names))
    slopes = np.zeros((len(SCORES), len(names)))
    for column, name in enumerate(names):
        if name in SCORES:
            slopes[SCORES.index(name), column] = random.uniform(3, 6)
        else:
            slopes[:, column] = random.normal(0, 0.4, len(SCORES))
    return Person(tuple(names[index] for index in order), slopes[:, order], random.uniform(-3.5, -2, len(SCORES)))
