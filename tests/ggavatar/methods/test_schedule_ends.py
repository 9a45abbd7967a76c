"""What every schedule has come to at the end of a training: nothing is destroyed and nothing is left unfinished."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.gaussians.density_control import DensityControl
from ggavatar.head.model import HeadModel
from ggavatar.training import registry
from ggavatar.training.plan import preset

GROWING = ("gaussian_avatars", "gaussian_blendshapes", "ggavatar", "ggavatar_plus", "splatting_avatar")
LENGTHS = (1_500, 6_000, 12_000, 12_345, 30_000, 120_000, 600_000)


def control_of(method: str, capture: Capture, head: HeadModel, steps: int, chosen: str) -> DensityControl:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    scene = Scene(head, tuple(drives), tuple(cameras), torch.ones(3), steps=steps)
    settings = registry.load(method).config(chosen)
    settings = dataclasses.replace(settings, perceptual_weight=0.0)
    if hasattr(settings, "first_colors"):
        settings = dataclasses.replace(settings, first_colors="grey")
    avatar = registry.load(method).build(settings, scene)
    return getattr(avatar, "avatar", avatar).density


@pytest.mark.parametrize("steps", LENGTHS)
@pytest.mark.parametrize("chosen", ["default", "paper"])
@pytest.mark.parametrize("method", GROWING)
def test_density_control_leaves_time_to_recover(
    method: str, chosen: str, steps: int, toy_capture: Capture, toy_head: HeadModel
) -> None:
    """An opacity reset or a round in the last step would be scored as it is: no update follows (3DGS uses `<`)."""
    control = control_of(method, toy_capture, toy_head, steps, chosen)
    due = {control.start, steps, *range(0, steps, control.reset_interval)}
    resets = [step for step in sorted(due) if step and control.resets(step)]
    rounds = [step for step in range(max(steps - 3 * control.interval, 1), steps + 1) if control.is_due(step)]
    assert not any(step > steps - control.reset_interval for step in resets)
    assert steps not in rounds and not control.is_active(steps)
    assert bool(resets) == (steps >= 12_000 and method != "gaussian_blendshapes")


@pytest.mark.parametrize("name", ["default", "fast"])
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_a_training_ends_at_full_size_and_the_lowest_rate(name: str, device: str) -> None:
    plan = preset(name, device)
    assert plan.size_at(plan.steps, 512, 512) == (512, 512)
    assert plan.rate_factor(plan.steps) == pytest.approx(0.02) and plan.rate_factor(1) == 1.0
    assert plan.rate_factor(round(0.6 * plan.steps)) == 1.0
