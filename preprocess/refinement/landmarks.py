"""Landmarks as a term of refinement: codes keep the meaning that the tracker gave them, in every frame with a face."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ggavatar.data.capture import Tracking
from ggavatar.geometry.transforms import project
from ggavatar.head.model import HeadModel
from preprocess.refinement.corrections import Corrections
from preprocess.refinement.drawing import Leaves, drive_of
from preprocess.tracking.pose.fusion import EFFECTIVE_LANDMARKS, LANDMARK_STD

STEP = 0.5
"""Of the finite differences, in units of the corrections."""


@dataclass(frozen=True)
class LandmarkTerm:
    """Detected landmarks and the vertices under them.

    What the tracked mesh misses in the median frame is the mesh's own error, and is not held against a frame.

    Attributes:
        head: The vertices that landmarks lie on, and those that joints depend on.
        corners: Vertices of the triangle of every landmark.
        weights: Barycentric weights in it.
        wanted: Detected positions minus the median miss, px; NaN where none was detected.
        scale: Standard deviation of a landmark, as one of `EFFECTIVE_LANDMARKS` independent ones, px.
    """

    head: HeadModel
    corners: Tensor
    weights: Tensor
    wanted: Float[np.ndarray, "T L 2"]
    scale: float

    @staticmethod
    def of(head: HeadModel, tracking: Tracking) -> LandmarkTerm | None:
        """The term of a tracking; None if it has no landmarks, or the head has no places for them."""
        if tracking.landmarks is None or head.landmark_weights is None or "landmarks" not in head.regions:
            return None
        weights = head.landmark_weights
        corners = head.regions["landmarks"].view(len(weights), 3)
        placed = torch.arange(min(len(weights), tracking.landmarks.shape[1]))
        placed = placed[weights[placed].sum(-1) > 0.5]
        used, inverse = torch.unique(
            torch.cat((corners[placed].flatten(), head.joint_regressor.abs().sum(0).nonzero().flatten())),
            return_inverse=True,
        )
        found = tracking.landmarks[:, placed.numpy()]
        small = part_of(head, used)
        start = LandmarkTerm(small, inverse[: 3 * len(placed)].view(-1, 3), weights[placed], found, 1.0)
        missed = found - np.stack([start.seen(tracking, row) for row in range(len(found))])
        with_face = np.isfinite(missed).all(axis=(1, 2))
        if not with_face.any():
            return None
        wanted = found - np.median(missed[with_face], axis=0)
        width = float(np.median(np.ptp(found[with_face, :, 0], axis=1)))
        scale = LANDMARK_STD * width * np.sqrt(len(placed) / EFFECTIVE_LANDMARKS)
        return dataclasses.replace(start, wanted=wanted, scale=scale)

    @property
    def found(self) -> Bool[np.ndarray, " T"]:
        """Frames in which a face was found."""
        return np.isfinite(self.wanted).all(axis=(1, 2))

    @torch.no_grad()
    def seen(self, tracking: Tracking, row: int) -> Float[np.ndarray, "L 2"]:
        """Where the landmarks of the mesh are in a frame, px."""
        return self._projected(tracking, row, Leaves.of(tracking, row, wanted=False)).double().numpy()

    def gradients(self, tracking: Tracking, rows: Sequence[int]) -> dict[str, np.ndarray]:
        """Gradient of half the squared misses over `scale`, linear beyond it, in some rows, by name of the array."""
        sums = {name: np.zeros(array.shape) for name, array in Leaves.arrays(tracking).items()}
        for row in (row for row in rows if self.found[row]):
            leaves = Leaves.of(tracking, row, wanted=True)
            self._misfit(tracking, row, leaves).backward()
            for name, gradient in leaves.gradients().items():
                sums[name][row] = gradient
        return sums

    def information(
        self, tracking: Tracking, corrections: Corrections, values: Float[np.ndarray, "T C"], rows: Sequence[int]
    ) -> Float[np.ndarray, "C C"]:
        """Mean information of a frame's landmarks about its corrections."""
        total, used = np.zeros((corrections.count, corrections.count)), 0
        for row in (row for row in rows if self.found[row]):
            one, now, own = tracking.rows(slice(row, row + 1)), values[row : row + 1], corrections.at(row)
            base = self.seen(own.moved(one, now), 0)
            steps = STEP * np.eye(corrections.count)
            moved = np.stack([self.seen(own.moved(one, now + step), 0) for step in steps])
            jacobian = ((moved - base) / (STEP * self.scale)).reshape(corrections.count, -1)
            total, used = total + jacobian @ jacobian.T, used + 1
        return total / max(used, 1)

    def _misfit(self, tracking: Tracking, row: int, leaves: Leaves) -> Tensor:
        missed = (self._projected(tracking, row, leaves) - torch.tensor(self.wanted[row]).float()) / self.scale
        return ((1 + missed.square().sum(-1)).sqrt() - 1).sum()

    def _projected(self, tracking: Tracking, row: int, leaves: Leaves) -> Float[Tensor, "L 2"]:
        vertices = self.head.vertices(drive_of(self.head, tracking, row, leaves))
        points = (vertices[self.corners] * self.weights[..., None]).sum(1)
        return project(points, torch.tensor(tracking.intrinsics[row]).float(), leaves.values["world_to_camera"])


def part_of(head: HeadModel, used: Tensor) -> HeadModel:
    """A head of some of the vertices, without faces and regions; joints must depend on no others."""
    return dataclasses.replace(
        head,
        template=head.template[used],
        faces=head.faces[:0],
        expression_basis=head.expression_basis[used],
        pose_basis=head.pose_basis[used],
        eyelid_basis=head.eyelid_basis[used],
        joint_regressor=head.joint_regressor[:, used],
        skinning_weights=head.skinning_weights[used],
        regions={},
        uv=None,
        landmark_weights=None,
    )
