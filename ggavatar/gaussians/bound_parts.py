"""A trained avatar of Gaussians on a head mesh as plain arrays, for programs that pose it themselves.

Methods whose avatars are such Gaussians have a method `bound_parts()`. `posed` says what the arrays mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.core import Drive, Gaussians
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.gaussians.offsets import Offsets, refine
from ggavatar.gaussians.spherical_harmonics import harmonics
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.optim.parameters import Rows

Layer = tuple[Tensor, Tensor]
"""Weight [out, in] and bias [out] of a linear layer."""


@dataclass(frozen=True)
class AdjusterParts:
    """What the Geometry Morph Adjuster adds: rows W f with W = A h + c and f = MLP(condition).

    Attributes:
        hidden: h of every Gaussian.
        last_weight: A; R is `GEOMETRY_ROWS`, or `COLOR_ROWS` more (`ggavatar.gaussians.offsets`).
        last_bias: c.
        latent_layers: The layers of f's network, ReLU between them.
        unit: Meters per unit of a position row.
        color_unit: sRGB per unit of a color row.
        sees_pose: Whether the condition ends with the head pose (`HeadPoses.condition`).
    """

    hidden: Float[Tensor, "N H"]
    last_weight: Float[Tensor, "R L H"]
    last_bias: Float[Tensor, "R L"]
    latent_layers: tuple[Layer, ...]
    unit: float
    color_unit: float
    sees_pose: bool

    def latent(self, condition: Float[Tensor, " C"]) -> Float[Tensor, " L"]:
        """The latent vector f."""
        *inner, (last_weight, last_bias) = self.latent_layers
        value = condition
        for weight, bias in inner:
            value = torch.relu(weight @ value + bias)
        return last_weight @ value + last_bias

    def offsets(self, condition: Float[Tensor, " C"]) -> Offsets:
        """The rows of every Gaussian."""
        latent = self.latent(condition)
        weight = torch.einsum("l,rlh->rh", latent, self.last_weight)
        return Offsets(self.hidden @ weight.T + self.last_bias @ latent)


@dataclass(frozen=True)
class BoundParts:
    """Gaussians in the local spaces of the triangles of a head, and what poses them.

    Attributes:
        head: The head model.
        poses: Mean and range of the head pose in training.
        face: The triangle of every Gaussian.
        means: Local positions, triangle units.
        quats: Local rotations, wxyz, of any nonzero length.
        log_scales: Logarithms of the local standard deviations, triangle units.
        opacity_logits: Before the sigmoid.
        harmonics: Spherical harmonics up to the degree in use.
        follows_face: Whether expressions and joints move the mesh; else it stays neutral.
        holds_torso: Whether the torso keeps its own pose (`HeadPoses.hold_torso`).
        adjuster: Its parts; None if the mesh alone moves the Gaussians.
    """

    head: HeadModel
    poses: HeadPoses
    face: Int[Tensor, " N"]
    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    log_scales: Float[Tensor, "N 3"]
    opacity_logits: Float[Tensor, " N"]
    harmonics: Float[Tensor, "N K 3"]
    follows_face: bool
    holds_torso: bool
    adjuster: AdjusterParts | None


def bound_columns(rows: Rows, degree: int) -> dict[str, Tensor]:
    """The columns of `bound_rows` by the names in `BoundParts`, with the harmonics up to a degree."""
    names = ("face", "means", "quats", "log_scales", "opacity_logits")
    colors = harmonics(rows)[:, : (degree + 1) ** 2]
    return {name: rows[name].detach() for name in names} | {"harmonics": colors.detach()}


def condition(parts: BoundParts, drive: Drive) -> Float[Tensor, " C"]:
    """The input of the adjuster's latent network."""
    face = parts.head.condition(drive)
    sees_pose = parts.adjuster is not None and parts.adjuster.sees_pose
    return torch.cat((face, parts.poses.condition(drive))) if sees_pose else face


@torch.no_grad()
def posed(parts: BoundParts, drive: Drive) -> Gaussians:
    """The avatar posed by `drive`, in world space; equals `gaussians(drive)` of the avatar that gave the parts."""
    head, adjuster = parts.head, parts.adjuster
    vertices = head.vertices(drive) if parts.follows_face else head.neutral()
    if parts.holds_torso:
        vertices = parts.poses.hold_torso(vertices, drive, head)
    frames = triangle_frames(vertices, head.faces)
    placed = bind(parts.means, parts.quats, parts.log_scales, parts.face, frames)
    colors = parts.harmonics
    if adjuster is not None:
        offsets = adjuster.offsets(condition(parts, drive))
        placed = refine(*placed, offsets, adjuster.unit)
        if offsets.colors is not None:
            constant = colors[:, :1] + (adjuster.color_unit / SH_C0) * offsets.colors[:, None]
            colors = torch.cat((constant, colors[:, 1:]), dim=1)
    return Gaussians(*placed, parts.opacity_logits.sigmoid(), colors)
