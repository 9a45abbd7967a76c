"""Heads posed by the Triton kernels, interpreted, against the torch twin in float64; compiled without spilling."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
import torch

from ggavatar.core import Drive
from ggavatar.head.model import HeadModel
from ggavatar.jit import device_kernels
from tests.ggavatar.head.test_model import random_drive, random_head
from tests.support.kernel_compiler import recorded_launches
from tests.support.triton_kernels import interpreted

pytestmark = interpreted


@pytest.fixture(autouse=True)
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU tensors in float32 take the way of those on CUDA."""
    monkeypatch.setattr(device_kernels, "run_on", lambda *tensors: all(t.dtype is torch.float32 for t in tensors))


def in_float32(head: HeadModel, drive: Drive) -> tuple[HeadModel, Drive]:
    values = {field.name: getattr(drive, field.name) for field in dataclasses.fields(drive)}
    return head.to("cpu", torch.float32), Drive(
        **{name: v.float() if isinstance(v, torch.Tensor) else v for name, v in values.items()}
    )


@pytest.mark.parametrize("pose_correctives", [True, False])
@pytest.mark.parametrize("scale", [1.0, 1e-5, 0.0])
def test_vertices_and_condition_equal_the_twin_in_float64(pose_correctives: bool, scale: float) -> None:
    """Large rotations, rotations in the range of the series, and none."""
    head, drive = random_head(pose_correctives), random_drive(scale)
    head32, drive32 = in_float32(head, drive)
    with recorded_launches() as launches:
        found, condition = head32.vertices(drive32), head32.condition(drive32)
    assert [launch.name for launch in launches] == ["pose_joints", "skin_vertices", "write_condition"]
    expected = head.vertices(drive)
    assert expected.dtype is torch.float64
    torch.testing.assert_close(found.double(), expected, atol=2e-6, rtol=2e-6)
    torch.testing.assert_close(condition.double(), head.condition(drive), atol=1e-6, rtol=1e-6)


def test_a_chain_of_five_joints_composes_all_its_ancestors() -> None:
    head = random_head(True)
    head = dataclasses.replace(head, parents=tuple(range(-1, len(head.parents) - 1)))
    drive = random_drive()
    found = HeadModel.vertices(*in_float32(head, drive))
    torch.testing.assert_close(found.double(), head.vertices(drive), atol=2e-6, rtol=2e-6)
    flat = dataclasses.replace(head, parents=(-1, *[0] * (len(head.parents) - 1)))
    assert (found - flat.vertices(drive)).abs().max() > 1e-3, "the hierarchy matters"


def test_whoever_wants_a_gradient_gets_it_from_the_twin() -> None:
    head, drive = in_float32(random_head(), random_drive())
    drive = dataclasses.replace(drive, joint_rotations=drive.joint_rotations.requires_grad_())
    with recorded_launches() as launches:
        (head.vertices(drive).sum() + head.condition(drive).sum()).backward()
        assert launches == [] and drive.joint_rotations.grad is not None
        with torch.no_grad():
            head.vertices(drive)
    assert launches, "without gradients the kernels do it"


def test_kernels_compile_without_spilling(registers_of: Callable[..., dict[str, int]]) -> None:
    head, drive = in_float32(random_head(), random_drive())
    with recorded_launches() as launches:
        head.vertices(drive)
        head.condition(drive)
    found = registers_of(launches)
    limits = {"pose_joints": 128, "skin_vertices": 64, "write_condition": 64}
    assert found.keys() == limits.keys() and all(found[name] <= limits[name] for name in limits), found
