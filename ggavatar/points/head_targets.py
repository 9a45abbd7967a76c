"""Targets from the head model for learned blendshapes and skinning weights (PointAvatar, Sec. 3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.head.model import HeadModel
from ggavatar.points.deformer import Bases

PAPER_COEFFICIENTS = 50
"""Number of expression coefficients in PointAvatar; its loss is divided by it."""


@dataclass(frozen=True)
class HeadTargets:
    """Bases of the head model at its vertices in the canonical pose, lengths in the unit of the points.

    Attributes:
        tree: Search tree of the vertices in the canonical pose.
        places: These vertices, for devices on which a search tree would wait for the host.
        blendshapes: Pose correctives, then expressions, then eyelids.
        weights: Skinning weights: 0 for the static joint, then those of the head's joints.
        variances: Variance of every expression and eyelid coefficient over the training frames.
    """

    tree: cKDTree
    places: Float[Tensor, "V 3"]
    blendshapes: Float[Tensor, "V B 3"]
    weights: Float[Tensor, "V J"]
    variances: Float[Tensor, " E"]

    @staticmethod
    def of(head: HeadModel, canonical: Drive, coefficients: Float[Tensor, "T E"], unit: float) -> HeadTargets:
        """Targets from a head.

        Args:
            head: The head model; without pose correctives, their targets are zero.
            canonical: The drive of the canonical pose.
            coefficients: Expression and eyelid coefficients of the training frames.
            unit: Units of length of the points per meter.
        """
        vertices = head.vertices(canonical)
        correctives = head.pose_basis
        if not correctives.shape[2]:
            correctives = vertices.new_zeros(len(vertices), 3, pose_features(head))
        shapes = torch.cat((correctives, head.expression_basis, head.eyelid_basis), dim=2) * unit
        still = vertices.new_zeros(len(vertices), 1)
        variances = coefficients.var(0) if len(coefficients) > 1 else torch.ones_like(coefficients[0])
        least = (0.01 * variances.mean()).clamp_min(1e-6)  # a constant coefficient would get an unbounded weight
        tree = cKDTree((vertices * unit).double().cpu().numpy())
        weights = torch.cat((still, head.skinning_weights), dim=1)
        return HeadTargets(tree, vertices * unit, shapes.transpose(1, 2), weights, variances.clamp_min(least))

    def nearest(self, points: Float[Tensor, "N 3"]) -> Int[Tensor, " N"]:
        """Index of the vertex nearest to every point in the canonical pose."""
        if points.device.type == "cuda":
            return torch.cdist(points.detach(), self.places).argmin(1)
        found = self.tree.query(points.detach().double().cpu().numpy())[1]
        return torch.from_numpy(np.asarray(found)).to(points.device)

    def losses(self, bases: Bases, points: Float[Tensor, "N 3"]) -> Mapping[str, Tensor]:
        """Mean squared differences from the nearest vertex: `skinning`, `correctives`, `expressions`.

        Args:
            bases: Learned bases at some points.
            points: Positions of these points in the head's canonical pose.
        """
        vertex = self.nearest(points)
        expressions = len(self.variances)
        apart = (10 * (bases.blendshapes - self.blendshapes[vertex])).square()
        weighed = apart[:, -expressions:] / self.variances[:, None] / PAPER_COEFFICIENTS
        return {
            "skinning": 0.1 * (bases.weights - self.weights[vertex]).square().mean(),
            "correctives": 10 * apart[:, :-expressions].sum() / max(apart[:, :-expressions].numel(), 1),
            "expressions": 10 * weighed.mean(),
        }


def pose_features(head: HeadModel) -> int:
    """Entries of vec(R − I) of all joints but the root."""
    return 9 * (len(head.parents) - 1)
