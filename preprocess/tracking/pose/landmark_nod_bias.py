"""Estimates and corrects the landmark network's under-reported head pitch.

The landmark network shows a nodding head as if it nodded less. The share is constant over a clip, so it can be
estimated from cues that do not share the bias; landmarks then keep what they measure well: every other rotation, and
what changes from frame to frame. Measured in docs/experiments/2026-11-29-skin-patch-depths-and-nod-bias.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from preprocess.tracking.geometry.rigid import POSE, Poses
from preprocess.tracking.pose.fusion import LandmarkEvidence

SAGITTAL = [0, 4, 5]
"""Steps of a pose that a nod is made of: the turn about the camera's x, and shifts along y and z."""
SPREAD = np.array([0.2, 0.03, 0.03])
"""Standard deviations of what landmarks hide of a nod: a share of the turn, and of both shifts in m per rad."""
HASTE = 1.5
"""Factor on each round's correction: landmarks hold the poses, too, so that a plain one goes half of the way."""


@dataclass(frozen=True)
class NoddingLandmarks:
    """Landmarks, and by how much they are off per radian of nod.

    Attributes:
        landmarks: As they were seen.
        hidden: Step from the head's pose to the one that landmarks show, per radian of nod; see `Poses.moved`.
    """

    landmarks: LandmarkEvidence
    hidden: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(POSE))

    def information(self, poses: Poses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Of every frame's pose."""
        return self.landmarks.information(poses.moved(nods(poses)[:, None] * self.hidden))

    def corrected(self, poses: Poses) -> NoddingLandmarks:
        """With what they hide as it would be, were the poses these: least squares over all frames, held by a prior."""
        turns = nods(poses)[:, None]
        information, gradient = self.information(poses)
        matrix = (turns[..., None] ** 2 * information).sum(axis=0)[np.ix_(SAGITTAL, SAGITTAL)] + np.diag(SPREAD**-2)
        vector = (turns * gradient).sum(axis=0)[SAGITTAL] - self.hidden[SAGITTAL] * SPREAD**-2
        hidden = self.hidden.copy()
        hidden[SAGITTAL] += HASTE * np.linalg.solve(matrix, vector)
        return NoddingLandmarks(self.landmarks, hidden)


def nods(poses: Poses) -> Float[np.ndarray, " T"]:
    """Turn of every frame's head about the camera's x axis, against the clip's average, rad."""
    average = Rotation.from_matrix(poses.rotations).mean()
    turns = (Rotation.from_matrix(poses.rotations) * average.inv()).as_rotvec()[:, 0]
    return turns - turns.mean()


def hidden_share(shown: Poses, true: Poses) -> float:
    """Share of the true nods that poses show too little of."""
    turns = nods(true)
    return float(1 - turns @ nods(shown) / max(turns @ turns, 1e-12))
