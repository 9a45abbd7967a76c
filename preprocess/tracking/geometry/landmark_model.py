"""The face as landmarks: neutral shape, expression axes and a rotating jaw; fitted to the clip before any mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

JAW_DEGREES = 2
"""Degrees of freedom of the jaw: opening (rotation about x) and sideways motion (about y)."""


@dataclass(frozen=True)
class FaceModel:
    """A linear model of the landmarks with a jaw joint.

    Attributes:
        neutral: Neutral positions in head space, m.
        axes: Displacement per unit of each coefficient, m.
        jaw_weights: Skinning weight of the jaw for each landmark.
        jaw_pivot: Point about which the jaw rotates, m.
    """

    neutral: Float[np.ndarray, "N 3"]
    axes: Float[np.ndarray, "N 3 A"]
    jaw_weights: Float[np.ndarray, " N"]
    jaw_pivot: Float[np.ndarray, "3"]

    def blend_matrices(self, jaw: Float[np.ndarray, "T 2"]) -> Float[np.ndarray, "T N 3 3"]:
        """Blended skinning matrices of the landmarks, without their translation."""
        rotation = Rotation.from_rotvec(np.column_stack((jaw, np.zeros(len(jaw))))).as_matrix() - np.eye(3)
        return np.eye(3) + self.jaw_weights[None, :, None, None] * rotation[:, None]

    def shapes(
        self, coefficients: Float[np.ndarray, "T A"], jaw: Float[np.ndarray, "T 2"]
    ) -> Float[np.ndarray, "T N 3"]:
        """Landmark positions in head space, m."""
        shaped = self.neutral + np.einsum("nxa,ta->tnx", self.axes, coefficients, optimize=True)
        arms = shaped - self.jaw_pivot
        rotation = Rotation.from_rotvec(np.column_stack((jaw, np.zeros(len(jaw))))).as_matrix() - np.eye(3)
        return shaped + self.jaw_weights[:, None] * (arms @ rotation.transpose(0, 2, 1))

    def jaw_jacobian(self) -> Float[np.ndarray, "N 3 2"]:
        """Displacement of the neutral landmarks per rad of jaw rotation about x and y, m."""
        arms = self.neutral - self.jaw_pivot
        about = [np.cross(axis, arms) for axis in np.eye(3)[:JAW_DEGREES]]
        return self.jaw_weights[:, None, None] * np.stack(about, axis=-1)


@dataclass(frozen=True)
class FaceMotion:
    """Parameters of a `FaceModel` in every frame.

    Attributes:
        coefficients: Of the model's axes.
        jaw: Rotation about x and y, rad.
    """

    coefficients: Float[np.ndarray, "T A"]
    jaw: Float[np.ndarray, "T 2"]
