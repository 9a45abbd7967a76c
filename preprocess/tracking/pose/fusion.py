"""Head poses that several kinds of evidence agree on: landmarks, the hair's outline, the skin's texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import Lens, Observations, Poses, pose_information, smooth_steps

LANDMARK_ERROR = 0.020
"""Of landmarks in a grimace, which err together, over the face's width."""
LANDMARKS_COUNT = 20.0
"""As many independent landmarks as all of them are worth."""
ROUNDS = 6


@runtime_checkable
class PoseEvidence(Protocol):
    """Something that tells of every frame's pose."""

    def information(self, poses: Poses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Information matrix and gradient of every frame's pose, in the steps of `Poses.moved`."""
        ...

    def corrected(self, poses: Poses) -> PoseEvidence:
        """The same with what it does not know of the head as it would be, were the poses these."""
        ...


@dataclass(frozen=True)
class LandmarkEvidence:
    """Where landmarks were seen, and where they are in head space.

    Attributes:
        observed: Landmarks with inverse variances.
        shapes: In head space as the expressions of every frame put them, m.
        lens: Camera.
    """

    observed: Observations
    shapes: Float[np.ndarray, "T N 3"]
    lens: Lens

    def information(self, poses: Poses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Of every frame's pose."""
        return pose_information(self.observed, self.shapes, self.lens, poses)

    def corrected(self, poses: Poses) -> LandmarkEvidence:
        """The same: it takes its shapes for known."""
        return self


def trusted_landmarks(seen: Observations, width: float) -> Observations:
    """Landmarks with variances such that all together are worth `LANDMARKS_COUNT`.

    Args:
        seen: Weights are relative, zero in frames without a face.
        width: Of the face in the image, px.
    """
    relative = seen.weights / max(float(seen.weights.max(axis=0).sum()), 1e-9)
    return Observations(seen.points, relative * LANDMARKS_COUNT / (LANDMARK_ERROR * width) ** 2)


def settle(evidence: Sequence[PoseEvidence], poses: Poses, smoothness: float) -> Poses:
    """Poses between all evidence (Gauss–Newton on all frames at once), which is corrected by them in every round.

    Args:
        evidence: What tells of poses.
        poses: Where to start.
        smoothness: Penalty on second differences; see `rigid.refine_poses`.
    """
    known = list(evidence)
    for _ in range(ROUNDS):
        known = [one.corrected(poses) for one in known]
        told = [one.information(poses) for one in known]
        information, gradient = (sum(parts[1:], parts[0]) for parts in zip(*told, strict=True))
        poses = poses.moved(smooth_steps(information, gradient, poses, smoothness))
    return poses
