"""Adaptive density control of Gaussians bound to triangles: grow, split, prune and reset as functions on `Rows`.

The rule is 3D Gaussian Splatting's (Kerbl et al. 2023, Sec. 5.2) with the binding inheritance of GaussianAvatars (Qian
et al. 2024, Sec. 3.3): children stay on their parent's face, and a face never loses its last Gaussian. `DensityControl`
decides when.

The rows hold the columns means [N, 3], quats [N, 4] and log_scales [N, 3] in units of their triangle and opacity_logits
[N], and carry face [N], gradient [N] and seen [N].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ggavatar.core import Rendering
from ggavatar.geometry.transforms import quaternion_to_matrix
from ggavatar.optim.parameters import Rows

SPLIT_CHILDREN = 2
SPLIT_SHRINK = 0.8 * SPLIT_CHILDREN


def statistics(count: int, device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """Empty statistics as carried columns: summed gradient norms and the number of times each row was seen."""
    return {"gradient": torch.zeros(count, device=device), "seen": torch.zeros(count, device=device)}


@torch.no_grad()
def accumulate(rows: Rows, rendering: Rendering) -> None:
    """Add the gradients of the projected centers to the statistics, per unit of an image 2 wide and 2 high (NDC)."""
    gradient = rendering.means2d.grad
    if gradient is None:
        return
    height, width = rendering.image.shape[:2]
    visible = rendering.radii > 0
    norm = (gradient * gradient.new_tensor([width / 2, height / 2])).norm(dim=-1)
    rows["gradient"].add_(torch.where(visible, norm, torch.zeros_like(norm)))
    rows["seen"].add_(visible)


def mean_gradients(rows: Rows) -> Float[Tensor, " N"]:
    """Average gradient norm over the frames that saw each row; 0 where none did."""
    return torch.nan_to_num(rows["gradient"] / rows["seen"], nan=0.0, posinf=0.0)


@torch.no_grad()
def grow(rows: Rows, chosen: Bool[Tensor, " N"]) -> None:
    """Append an exact copy of every chosen row."""
    rows.append({name: values[chosen] for name, values in rows.columns().items()})


@torch.no_grad()
def split(
    rows: Rows, chosen: Bool[Tensor, " N"], generator: torch.Generator, face_scales: Float[Tensor, " F"] | None = None
) -> None:
    """Replace every chosen row by two smaller ones, drawn from its own distribution.

    The children's offsets use the standard deviation in the triangle's space, in which means live. With `face_scales`
    (m) they use the world's, as GaussianAvatars' code does by mistake: children then lie too close to their parent.
    """
    parents = {name: values[chosen].repeat_interleave(SPLIT_CHILDREN, 0) for name, values in rows.columns().items()}
    deviation = parents["log_scales"].exp()
    if face_scales is not None:
        deviation = deviation * face_scales[parents["face"], None]
    noise = torch.randn(deviation.shape, generator=generator).to(deviation)
    offset = (quaternion_to_matrix(parents["quats"]) @ (deviation * noise)[..., None]).squeeze(-1)
    children = {
        **parents,
        "means": parents["means"] + offset,
        "log_scales": parents["log_scales"] - math.log(SPLIT_SHRINK),
    }
    rows.append(children)
    born = torch.zeros(len(children["means"]), dtype=torch.bool, device=chosen.device)
    rows.take(torch.cat((~chosen, ~born)).nonzero().squeeze(-1))


def spare_last(doomed: Bool[Tensor, " N"], face: Int[Tensor, " N"]) -> Bool[Tensor, " N"]:
    """`doomed` without the rows of every face that would be left bare."""
    count = int(face.max()) + 1
    total = torch.bincount(face, minlength=count)
    lost = torch.bincount(face[doomed], minlength=count)
    return doomed & (lost < total)[face]


@torch.no_grad()
def prune(rows: Rows, doomed: Bool[Tensor, " N"]) -> None:
    """Remove the doomed rows, except those of a face that would be left bare."""
    rows.take((~spare_last(doomed, rows["face"])).nonzero().squeeze(-1))


@torch.no_grad()
def reset_opacity(rows: Rows, ceiling: float = 0.01) -> None:
    """Lower every opacity to at most `ceiling` and forget the moments of the column."""
    rows.replace("opacity_logits", rows["opacity_logits"].clamp_max(math.log(ceiling / (1 - ceiling))))


@dataclass(frozen=True)
class DensityControl:
    """When to grow, split, prune and reset, and by which thresholds.

    Attributes:
        start: No density control up to and including this step.
        stop: None after this step.
        interval: Steps between two rounds.
        reset_interval: Steps between two opacity resets.
        resetting: Whether there are resets; without them `reset_interval` still says when large rows begin to be
            removed.
        reset_at_start: Reset at `start` too (3DGS does on a white background).
        gradient: Mean NDC gradient norm from which a row grows.
        extent: Size of the scene the two scale limits are relative to, m.
        grow_scale: Rows up to this share of the extent are copied, larger ones split.
        prune_scale: Rows above this share are removed once `reset_interval` steps have passed.
        prune_opacity: Rows below this opacity are removed.
        budget: Largest number of rows; those with the largest gradients grow first.
        ramp: Whether the budget opens evenly from the first round to the last, so that coarse images are not drawn with
            rows only fine ones need (as DashGaussian couples the two); otherwise all of it is there from the start.
        split_in: Space of the standard deviations that spread the children of a split; see `split`.
    """

    start: int
    stop: int
    interval: int
    reset_interval: int
    resetting: bool = True
    reset_at_start: bool = False
    gradient: float = 2e-4
    extent: float = 1.0
    grow_scale: float = 0.01
    prune_scale: float = 0.1
    prune_opacity: float = 0.005
    budget: int = 1_000_000
    ramp: bool = False
    split_in: Literal["local", "world"] = "local"

    def is_active(self, step: int) -> bool:
        """Whether statistics are kept at this step."""
        return step <= self.stop

    def is_due(self, step: int) -> bool:
        """Whether a round of growing and pruning follows this step."""
        return self.start < step <= self.stop and step % self.interval == 0

    def resets(self, step: int) -> bool:
        """Whether the opacities are reset after this step."""
        if not self.resetting or step > self.stop:
            return False
        return step % self.reset_interval == 0 or (self.reset_at_start and step == self.start)

    def apply(self, rows: Rows, step: int, face_scales: Float[Tensor, " F"], generator: torch.Generator) -> bool:
        """Do what is due after `step`.

        `face_scales` in m turn local scales into world ones. True if rows were added or removed.
        """
        changed = self.is_due(step)
        if changed:
            self._round(rows, step, face_scales, generator)
        if self.resets(step):
            reset_opacity(rows)
        return changed

    def _round(self, rows: Rows, step: int, face_scales: Tensor, generator: torch.Generator) -> None:
        growing = self._within_budget(mean_gradients(rows), step)
        small = _world_sizes(rows, face_scales) <= self.grow_scale * self.extent
        copies = int((growing & small).sum())
        grow(rows, growing & small)
        spread = face_scales if self.split_in == "world" else None
        split(rows, torch.cat((growing & ~small, growing.new_zeros(copies))), generator, spread)
        doomed = rows["opacity_logits"].detach().sigmoid() < self.prune_opacity
        if step > self.reset_interval:
            doomed |= _world_sizes(rows, face_scales) > self.prune_scale * self.extent
        prune(rows, doomed)
        rows["gradient"].zero_()
        rows["seen"].zero_()

    def _within_budget(self, gradients: Tensor, step: int) -> Tensor:
        """Rows that shall grow: above the threshold, and at most as many as the budget has room for."""
        growing = gradients >= self.gradient
        room = max(self.budget - len(gradients), 0)
        if self.ramp:
            rounds_left = (self.stop - step) // self.interval + 1
            room //= max(rounds_left, 1)
        if int(growing.sum()) > room:
            ranked = torch.where(growing, gradients, -torch.ones_like(gradients)).argsort(descending=True, stable=True)
            growing = torch.zeros_like(growing)
            growing[ranked[:room]] = True
        return growing


def _world_sizes(rows: Rows, face_scales: Tensor) -> Tensor:
    """Largest standard deviation of every row, m."""
    return rows["log_scales"].detach().exp().amax(-1) * face_scales[rows["face"]]
