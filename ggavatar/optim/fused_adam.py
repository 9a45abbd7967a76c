"""A step of torch's fused Adam over all parameter groups at once, which the device may leave out.

`torch.optim.Adam` counts the step of every group with launches of its own, and undoes it likewise where a step is left
out; methods here have a group for every kind of row, so that this would be most of what an update launches.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


@torch.no_grad()
def fused_adam_step(optimizer: torch.optim.Optimizer, is_bad: Tensor) -> bool:
    """Take a step unless `is_bad` is 1; it equals that of `torch.optim.Adam(fused=True)` with `found_inf` bit by bit.

    Args:
        optimizer: Any; nothing happens if it is no fused Adam, or if a parameter has no state yet.
        is_bad: A number on the device, 1 or 0.

    Returns:
        Whether this optimizer's step was taken care of.
    """
    if type(optimizer) is not torch.optim.Adam:
        return False
    groups = [(group, [p for p in group["params"] if p.grad is not None]) for group in optimizer.param_groups]
    if not all(group["fused"] and not group["amsgrad"] for group, _ in groups):
        return False
    if any(not optimizer.state.get(parameter) for _, parameters in groups for parameter in parameters):
        return False
    steps = [optimizer.state[parameter]["step"] for _, parameters in groups for parameter in parameters]
    if steps:
        torch._foreach_add_(steps, 1)
        for group, parameters in groups:
            _update(optimizer, group, parameters, is_bad)
        torch._foreach_sub_(steps, [is_bad] * len(steps))
    return True


def _update(optimizer: torch.optim.Optimizer, group: dict[str, Any], parameters: list[Tensor], is_bad: Tensor) -> None:
    """Update the parameters of a group and their moments, whose steps have been counted."""
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    states = [optimizer.state[parameter] for parameter in parameters]
    first, second, steps = ([state[name] for state in states] for name in ("exp_avg", "exp_avg_sq", "step"))
    beta1, beta2 = group["betas"]
    if parameters:
        torch._fused_adam_(
            parameters, gradients, first, second, [], steps,
            lr=float(group["lr"]), beta1=beta1, beta2=beta2, weight_decay=group["weight_decay"], eps=group["eps"],
            amsgrad=False, maximize=group["maximize"], grad_scale=None, found_inf=is_bad,
        )  # fmt: skip
