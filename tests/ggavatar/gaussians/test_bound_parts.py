"""An avatar as arrays poses like the avatar itself, for every method that offers its arrays."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch

from ggavatar.core import Gaussians
from ggavatar.data.capture import Capture
from ggavatar.gaussians.bound_parts import posed
from ggavatar.training.registry import load, names
from tests.support.untrained_avatars import untrained

OFFERING = {"ggavatar", "ggavatar_plus", "gaussian_avatars"}
WITHOUT = {"flash_avatar", "gaussian_blendshapes", "point_avatar", "ps_avatar", "splatting_avatar"}


def assert_same(found: Gaussians, expected: Gaussians) -> None:
    assert expected.sh_degree is not None and found.sh_degree is None
    used = (expected.sh_degree + 1) ** 2
    torch.testing.assert_close(found.colors, expected.colors[:, :used], atol=2e-6, rtol=1e-5)
    for field in ("means", "scales", "opacities"):
        torch.testing.assert_close(getattr(found, field), getattr(expected, field), atol=2e-7, rtol=1e-5)
    same = (found.quats * expected.quats).sum(-1).abs()
    torch.testing.assert_close(same, torch.ones_like(same), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("method", "steps_done", "settings"),
    [
        ("ggavatar", 100, {"sh_degree": 3, "sh_iterations": 1000}),
        ("ggavatar", 2, {}),
        ("ggavatar_without_adjuster", 100, {}),
        ("ggavatar_without_lbs", 100, {}),
        ("ggavatar_without_triplane", 100, {}),
        ("ggavatar", 100, {"pose_on": "neck", "skinning": "false"}),
        ("ggavatar_plus", 100, {}),
        ("ggavatar_plus_without_colour", 100, {}),
        ("gaussian_avatars", 100, {}),
    ],
)
def test_parts_pose_like_the_avatar(
    method: str, steps_done: int, settings: dict[str, Any], toy_capture: Capture
) -> None:
    avatar, reader = untrained(method, toy_capture, steps_done, **settings)
    parts = avatar.bound_parts()
    for number in toy_capture.frames[:3]:
        drive = dataclasses.replace(reader.drive(number), frame=None)
        with torch.no_grad():
            assert_same(posed(parts, drive), avatar.gaussians(drive))
    assert not any(value.requires_grad for value in vars(parts).values() if isinstance(value, torch.Tensor))


def test_who_offers_parts_is_said_by_the_methods() -> None:
    """Guards the list above: a new method must be put into one of the two sets."""
    own = {name for name in names() if load(name).overrides == {}}
    assert own == OFFERING | WITHOUT
