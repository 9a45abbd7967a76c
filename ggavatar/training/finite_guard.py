"""What happens to a step whose loss or gradient is not finite: it changes nothing, and too many end the training.

On a CPU the values are looked at in every step. On a device that would make the host wait, so the device itself skips
the update, counts, and is asked every few steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ggavatar.optim.fused_adam import fused_adam_step

CAUSES = (
    "Common causes: tracking that puts the head behind the camera or far away (run ggavatar-doctor on the capture), a "
    "learning rate that is too high, an empty mask. Earlier checkpoints are intact."
)


class TrainingError(RuntimeError):
    """The training cannot continue; the last checkpoint is intact."""


@dataclass
class FiniteGuard:
    """Skips steps whose loss or gradient is not finite, and stops the training after too many of them.

    Attributes:
        limit: Number of skipped steps at which the training stops.
        count: Steps skipped so far.
    """

    limit: int
    count: int = 0

    def passes(self, step: int, terms: Mapping[str, Tensor], avatar: nn.Module) -> bool:
        """Whether all loss terms and gradients are finite; call it after the backward pass.

        Raises:
            TrainingError: The limit is reached.
        """
        source = _find_not_finite(terms, avatar)
        if source is None:
            return True
        self.count += 1
        if self.count >= self.limit:
            raise TrainingError(f"step {step}: {source} is not finite; this has happened {self.count} times. {CAUSES}")
        return False


def _find_not_finite(terms: Mapping[str, Tensor], avatar: nn.Module) -> str | None:
    for name, value in terms.items():
        if not math.isfinite(value.item()):
            return f"loss term {name!r}"
    gradients = {name: parameter.grad for name, parameter in avatar.named_parameters() if parameter.grad is not None}
    sums = torch.stack([gradient.sum() for gradient in gradients.values()]) if gradients else torch.zeros(0)
    if bool(torch.isfinite(sums).all()):
        return None
    return "the gradient of " + next(
        name for name, total in zip(gradients, sums.tolist(), strict=True) if not math.isfinite(total)
    )


class DeviceGuard:
    """The same on a device, without waiting for it.

    Attributes:
        limit: Number of skipped steps at which the training stops.
        counts: On the device: steps with a loss, and with a gradient, that is not finite.
    """

    def __init__(self, limit: int, device: torch.device) -> None:
        self.limit = limit
        self.counts = torch.zeros(2, device=device)
        self._is_bad = torch.zeros(2, device=device)

    @torch.no_grad()
    def mark(self, loss: Tensor, avatar: nn.Module) -> Tensor:
        """Count on the device whether loss and gradients are finite; call it after the backward pass.

        Returns:
            A number on the device: 1 if the step must change nothing, else 0.
        """
        gradients = [_values(parameter.grad) for parameter in avatar.parameters() if parameter.grad is not None]
        norms = torch.stack(torch._foreach_norm(gradients)).sum() if gradients else torch.zeros_like(loss)
        values = torch.stack((loss.detach(), norms))
        torch.ne(values - values, 0, out=self._is_bad)  # what is not finite less itself is NaN
        self.counts += self._is_bad
        return self._is_bad.amax()

    def check(self, step: int, counts: Sequence[float]) -> None:
        """Look at the values of `counts`, which the caller has read.

        Raises:
            TrainingError: The limit is reached.
        """
        if max(counts) >= self.limit:
            source = "the loss" if counts[0] >= counts[1] else "a gradient"
            raise TrainingError(
                f"step {step}: {source} is not finite; this has happened {round(max(counts))} times. {CAUSES}"
            )


@torch.no_grad()
def step_unless(is_bad: Tensor, optimizer: torch.optim.Optimizer) -> None:
    """One step of an optimizer, which the device leaves out if `is_bad` is 1.

    Optimizers that cannot leave out a step (fused ones can, for mixed precision) take it with gradients of zero.
    """
    if fused_adam_step(optimizer, is_bad):
        return
    if getattr(optimizer, "_step_supports_amp_scaling", False):
        optimizer.found_inf = is_bad  # type: ignore[attr-defined]  # as torch.amp.GradScaler does
        try:
            optimizer.step()
        finally:
            del optimizer.found_inf  # type: ignore[attr-defined]
        return
    for group in optimizer.param_groups:
        for parameter in group["params"]:
            if parameter.grad is not None:
                clear_if(is_bad, _values(parameter.grad))
    optimizer.step()


def clear_if(is_bad: Tensor, values: Tensor | None) -> None:
    """Set values to zero, in place, if `is_bad` is 1."""
    if values is not None:
        values.masked_fill_(is_bad.bool(), 0.0)


def _values(gradient: Tensor) -> Tensor:
    return gradient._values() if gradient.is_sparse else gradient
