"""Fusion of pose cues: head poses from landmarks, the hair's outline and the skin's texture together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import (
    LandmarkObservations,
    PinholeIntrinsics,
    RigidPoses,
    pose_information,
    smooth_steps,
)

LANDMARK_STD = 0.020
"""Standard deviation of the landmarks' common error in a strong expression, over the face's width."""
EFFECTIVE_LANDMARKS = 20.0
"""Effective number of independent landmarks among all of them."""
ITERATIONS = 6
"""Gauss–Newton steps on the fused poses."""


@runtime_checkable
class PoseCue(Protocol):
    """A measurement that constrains the pose of every frame."""

    def information(self, poses: RigidPoses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Information matrix and gradient of every frame's pose, in the steps of `RigidPoses.moved`."""
        ...

    def refined(self, poses: RigidPoses) -> PoseCue:
        """The cue with its own unknowns (references, biases) re-estimated, given these poses."""
        ...


@dataclass(frozen=True)
class LandmarkCue:
    """Observed landmarks and their positions in head space.

    Attributes:
        observed: Landmarks with inverse variances.
        shapes: Landmarks in head space under the expression of every frame, m.
        intrinsics: Of the camera.
    """

    observed: LandmarkObservations
    shapes: Float[np.ndarray, "T N 3"]
    intrinsics: PinholeIntrinsics

    def information(self, poses: RigidPoses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Information matrix and gradient of every frame's pose."""
        return pose_information(self.observed, self.shapes, self.intrinsics, poses)

    def refined(self, poses: RigidPoses) -> LandmarkCue:
        """Itself: this cue has no unknowns of its own."""
        return self


def effective_observations(observed: LandmarkObservations, face_width: float) -> LandmarkObservations:
    """Landmarks with inverse variances that sum up to those of `EFFECTIVE_LANDMARKS` independent ones.

    Args:
        observed: With relative weights, zero in frames without a face.
        face_width: In the image, px.
    """
    relative = observed.weights / max(float(observed.weights.max(axis=0).sum()), 1e-9)
    return LandmarkObservations(observed.points, relative * EFFECTIVE_LANDMARKS / (LANDMARK_STD * face_width) ** 2)


def fuse_poses(cues: Sequence[PoseCue], poses: RigidPoses, smoothness: float) -> RigidPoses:
    """Poses that fit all cues together (Gauss–Newton on all frames at once); each step refines the cues first.

    Args:
        cues: Measurements of the poses.
        poses: Initial poses.
        smoothness: Penalty on second differences; see `rigid.refine_poses`.
    """
    refined = list(cues)
    for _ in range(ITERATIONS):
        refined = [cue.refined(poses) for cue in refined]
        contributions = [cue.information(poses) for cue in refined]
        information, gradient = (sum(parts[1:], parts[0]) for parts in zip(*contributions, strict=True))
        poses = poses.moved(smooth_steps(information, gradient, poses, smoothness))
    return poses
