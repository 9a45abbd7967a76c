"""The face as landmarks: neutral shape, expression axes and a jaw that turns.

What the clip's motion is fitted with, before any mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

JAW_DEGREES = 2
"""Degrees of freedom of the jaw: opening (about x) and sideways (about y)."""


@dataclass(frozen=True)
class FaceModel:
    """Landmarks that a few numbers move.

    Attributes:
        neutral: Resting positions in head space, m.
        axes: Displacement per unit of each coefficient, m.
        jaw_share: How far each landmark follows the jaw.
        jaw_pivot: Point about which the jaw turns, m.
    """

    neutral: Float[np.ndarray, "N 3"]
    axes: Float[np.ndarray, "N 3 A"]
    jaw_share: Float[np.ndarray, " N"]
    jaw_pivot: Float[np.ndarray, "3"]

    def blends(self, jaw: Float[np.ndarray, "T 2"]) -> Float[np.ndarray, "T N 3 3"]:
        """The linear part of skinning for each landmark."""
        turned = Rotation.from_rotvec(np.column_stack((jaw, np.zeros(len(jaw))))).as_matrix() - np.eye(3)
        return np.eye(3) + self.jaw_share[None, :, None, None] * turned[:, None]

    def shapes(
        self, coefficients: Float[np.ndarray, "T A"], jaw: Float[np.ndarray, "T 2"]
    ) -> Float[np.ndarray, "T N 3"]:
        """Landmarks in head space, m."""
        shaped = self.neutral + np.einsum("nxa,ta->tnx", self.axes, coefficients, optimize=True)
        arms = shaped - self.jaw_pivot
        turned = Rotation.from_rotvec(np.column_stack((jaw, np.zeros(len(jaw))))).as_matrix() - np.eye(3)
        return shaped + self.jaw_share[:, None] * (arms @ turned.transpose(0, 2, 1))

    def jaw_slopes(self) -> Float[np.ndarray, "N 3 2"]:
        """Displacement of the neutral landmarks per rad of the jaw, about x and about y."""
        arms = self.neutral - self.jaw_pivot
        about = [np.cross(axis, arms) for axis in np.eye(3)[:JAW_DEGREES]]
        return self.jaw_share[:, None, None] * np.stack(about, axis=-1)


@dataclass(frozen=True)
class FaceMotion:
    """How the face moves in each frame.

    Attributes:
        coefficients: Of the model's axes.
        jaw: Turn about x and y, rad.
    """

    coefficients: Float[np.ndarray, "T A"]
    jaw: Float[np.ndarray, "T 2"]
