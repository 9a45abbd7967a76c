"""Adaptive density control of Gaussians bound to triangles: grow, split, prune and reset as functions on `Rows`.

The rule is 3D Gaussian Splatting's (Kerbl et al. 2023, Sec. 5.2) with the binding inheritance of GaussianAvatars (Qian
et al. 2024, Sec. 3.3): children stay on their parent's face, and a face never loses its last Gaussian. `DensityControl`
is the schedule.

The rows hold the columns means [N, 3], quats [N, 4] and log_scales [N, 3] in units of their triangle and opacity_logits
[N], and carry face [N], gradient [N] and seen [N].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ggavatar.core import Rendering
from ggavatar.geometry.transforms import quaternion_to_matrix
from ggavatar.jit.constants import constant_like
from ggavatar.optim.parameters import Rows
from ggavatar.optim.schedules import scaled

SPLIT_CHILDREN = 2
SPLIT_SHRINK = 0.8 * SPLIT_CHILDREN


def statistics(count: int, device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """Statistics of zero as carried columns: sums of gradient norms, and how often each row was visible."""
    return {"gradient": torch.zeros(count, device=device), "seen": torch.zeros(count, device=device)}


@torch.no_grad()
def accumulate(rows: Rows, rendering: Rendering) -> None:
    """Add the gradients of the projected centers, in normalized device coordinates, to the statistics."""
    gradient = rendering.means2d.grad
    if gradient is None:
        return
    height, width = rendering.image.shape[:2]
    visible = rendering.radii > 0
    norm = (gradient * constant_like((width / 2, height / 2), gradient)).norm(dim=-1)
    rows["gradient"].add_(torch.where(visible, norm, torch.zeros_like(norm)))
    rows["seen"].add_(visible)


def mean_gradients(rows: Rows) -> Float[Tensor, " N"]:
    """Mean gradient norm over the frames in which each row was visible; 0 for rows that never were."""
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

    The children's offsets use the standard deviation in the triangle's local space, like the means. With `face_scales`
    (m) they use the one in world space, as GaussianAvatars' code does by mistake, so that children lie too close to
    their parent.
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
    new_rows = torch.zeros(len(children["means"]), dtype=torch.bool, device=chosen.device)
    rows.take(torch.cat((~chosen, ~new_rows)).nonzero().squeeze(-1))


def keep_last_per_face(to_prune: Bool[Tensor, " N"], face: Int[Tensor, " N"]) -> Bool[Tensor, " N"]:
    """`to_prune` without the rows of every face that would lose all of them."""
    count = int(face.max()) + 1
    total = torch.bincount(face, minlength=count)
    lost = torch.bincount(face[to_prune], minlength=count)
    return to_prune & (lost < total)[face]


@torch.no_grad()
def prune(rows: Rows, to_prune: Bool[Tensor, " N"]) -> None:
    """Remove the rows `to_prune`, except those of a face that would lose all of them."""
    rows.take((~keep_last_per_face(to_prune, rows["face"])).nonzero().squeeze(-1))


@torch.no_grad()
def reset_opacity(rows: Rows, ceiling: float = 0.01) -> None:
    """Lower every opacity to at most `ceiling` and reset the moments of the column."""
    rows.replace("opacity_logits", rows["opacity_logits"].clamp_max(math.log(ceiling / (1 - ceiling))))


@dataclass(frozen=True)
class DensityControl:
    """Schedule and thresholds of growing, splitting, pruning and opacity resets.

    Attributes:
        start: Last step without density control.
        stop: First step without density control again.
        interval: Steps between two rounds.
        reset_interval: Steps between two opacity resets, and the least number left before `stop` after one.
        resetting: Whether opacities are reset; without resets `reset_interval` is still the step after which large rows
            are removed.
        reset_at_start: Reset at `start` too (3DGS does so on a white background).
        gradient: Mean gradient norm in normalized device coordinates from which a row grows.
        extent: Size of the scene that the two scale limits are relative to, m.
        grow_scale: Rows up to this fraction of the extent are copied, larger ones are split.
        prune_scale: Rows above this fraction are removed once `reset_interval` steps have passed.
        prune_opacity: Rows below this opacity are removed.
        budget: Maximum number of rows; those with the largest gradients grow first.
        ramp: Whether the budget becomes available evenly over the rounds, so that coarse-resolution steps do not render
            rows that only fine ones need (coupled as in DashGaussian), or all of it in the first round.
        split_in: Space of the standard deviations that spread the children of a split; see `split`.
        splitter: Replaces chosen rows by two each, for rows that are not in the local space of triangles; None is
            `split`.
        keep_last: Whether a triangle keeps its last row (GaussianAvatars).
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
    splitter: Callable[[Rows, Tensor, torch.Generator], None] | None = None
    keep_last: bool = True

    def is_active(self, step: int) -> bool:
        """Whether statistics are accumulated at this step."""
        return step < self.stop

    def is_due(self, step: int) -> bool:
        """Whether a round of growing and pruning follows this step."""
        return self.start < step < self.stop and step % self.interval == 0

    def resets(self, step: int) -> bool:
        """Whether the opacities are reset after this step: never without a whole interval left to recover in."""
        if not self.resetting or step + self.reset_interval > self.stop:
            return False
        return step % self.reset_interval == 0 or (self.reset_at_start and step == self.start)

    def apply(self, rows: Rows, step: int, face_scales: Float[Tensor, " F"], generator: torch.Generator) -> bool:
        """Perform the round and the reset that are due after `step`; true if rows may have been added or removed.

        Args:
            rows: The Gaussians; changed in place.
            step: The step just completed.
            face_scales: Size of every triangle, m, which converts local scales to world scales.
            generator: Draws the children of splits.
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
        to_split = torch.cat((growing & ~small, growing.new_zeros(copies)))
        if self.splitter is None:
            split(rows, to_split, generator, face_scales if self.split_in == "world" else None)
        else:
            self.splitter(rows, to_split, generator)
        to_prune = rows["opacity_logits"].detach().sigmoid() < self.prune_opacity
        if step > self.reset_interval:
            to_prune |= _world_sizes(rows, face_scales) > self.prune_scale * self.extent
        if self.keep_last or bool(to_prune.all()):
            prune(rows, to_prune)
        else:
            rows.take((~to_prune).nonzero().squeeze(-1))
        rows["gradient"].zero_()
        rows["seen"].zero_()

    def _within_budget(self, gradients: Tensor, step: int) -> Tensor:
        """Mask of the rows to grow: above the threshold, and no more than the budget allows."""
        growing = gradients >= self.gradient
        room = max(self.budget - len(gradients), 0)
        if self.ramp:
            rounds_left = (self.stop - 1 - step) // self.interval + 1
            room //= max(rounds_left, 1)
        if int(growing.sum()) > room:
            ranked = torch.where(growing, gradients, -torch.ones_like(gradients)).argsort(descending=True, stable=True)
            growing = torch.zeros_like(growing)
            growing[ranked[:room]] = True
        return growing


def scaled_schedule(
    start: int, stop: int, interval: int, reset_interval: int, steps: int, iterations: int
) -> tuple[int, int, int, int]:
    """The first four fields of `DensityControl` for a training of `steps`, from those for one of `iterations`.

    Short trainings keep an interval of 20 steps, or of 10 to 20 steps to have 30 rounds, and 10 rounds between resets.
    """
    first, last = scaled(start, steps, iterations), scaled(stop, steps, iterations)
    between = max(min(max(20, scaled(interval, steps, iterations)), (last - first) // 30), 10)
    return first, last, between, max(scaled(reset_interval, steps, iterations), 10 * between)


def _world_sizes(rows: Rows, face_scales: Tensor) -> Tensor:
    """Largest standard deviation of every row in world space, m."""
    return rows["log_scales"].detach().exp().amax(-1) * face_scales[rows["face"]]
