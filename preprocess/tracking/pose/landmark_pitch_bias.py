"""Landmark pitch bias: estimates and corrects the landmark network's under-reported head pitch.

The landmark network shows a nodding head as if it nodded less. The bias is proportional to the pitch and constant over
a clip, so it can be estimated from cues that do not share it; landmarks then keep what they measure well: every other
rotation, and what changes from frame to frame. Measured in
docs/experiments/2026-11-29-skin-patch-depths-and-nod-bias.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from preprocess.tracking.geometry.rigid import POSE_SIZE, RigidPoses
from preprocess.tracking.pose.fusion import LandmarkCue

SAGITTAL = [0, 4, 5]
"""Components of a pose step that a nod consists of: rotation about the camera's x, and translation along y and z."""
BIAS_STD = np.array([0.2, 0.03, 0.03])
"""Prior standard deviations of the bias: a share of the rotation, and translations in m per rad."""
CORRECTION_GAIN = 1.5
"""Factor on each correction of the bias: landmarks also hold the poses, so that a plain step goes half of the way."""


@dataclass(frozen=True)
class PitchBiasedLandmarkCue:
    """A landmark cue with a bias proportional to the head's pitch.

    Attributes:
        landmarks: The cue as observed.
        bias: Step from the head's pose to the one that landmarks show, per radian of pitch; see `RigidPoses.moved`.
    """

    landmarks: LandmarkCue
    bias: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(POSE_SIZE))

    def information(self, poses: RigidPoses) -> tuple[Float[np.ndarray, "T 6 6"], Float[np.ndarray, "T 6"]]:
        """Information matrix and gradient of every frame's pose."""
        return self.landmarks.information(poses.moved(pitch_angles(poses)[:, None] * self.bias))

    def refined(self, poses: RigidPoses) -> PitchBiasedLandmarkCue:
        """The cue with its bias re-estimated, given these poses: least squares over all frames under the prior."""
        pitch = pitch_angles(poses)[:, None]
        information, gradient = self.information(poses)
        matrix = (pitch[..., None] ** 2 * information).sum(axis=0)[np.ix_(SAGITTAL, SAGITTAL)] + np.diag(BIAS_STD**-2)
        vector = (pitch * gradient).sum(axis=0)[SAGITTAL] - self.bias[SAGITTAL] * BIAS_STD**-2
        bias = self.bias.copy()
        bias[SAGITTAL] += CORRECTION_GAIN * np.linalg.solve(matrix, vector)
        return PitchBiasedLandmarkCue(self.landmarks, bias)


def pitch_angles(poses: RigidPoses) -> Float[np.ndarray, " T"]:
    """Rotation of the head about the camera's x axis in every frame, relative to the clip's mean, rad."""
    mean = Rotation.from_matrix(poses.rotations).mean()
    angles = (Rotation.from_matrix(poses.rotations) * mean.inv()).as_rotvec()[:, 0]
    return angles - angles.mean()


def underreported_pitch(reported: RigidPoses, true: RigidPoses) -> float:
    """Share of the true pitch angles that is missing from the reported poses."""
    pitch = pitch_angles(true)
    return float(1 - pitch @ pitch_angles(reported) / max(pitch @ pitch, 1e-12))
