"""Triangle frames by the Triton kernel, interpreted, against the torch twin in float64; compiled without spilling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from ggavatar.geometry.triangles import triangle_frames, triangle_frames_torch
from ggavatar.jit import device_kernels
from tests.support.kernel_compiler import recorded_launches
from tests.support.triton_kernels import interpreted

pytestmark = interpreted


@pytest.fixture(autouse=True)
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU tensors take the way of those on CUDA."""
    monkeypatch.setattr(device_kernels, "run_on", lambda *_: True)


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_frames_equal_the_twin_in_float64() -> None:
    """Two hundred triangles; one is a point, one a line, one has its last two corners in one place."""
    generator = torch.Generator().manual_seed(0)
    vertices, faces = (
        torch.randn(90, 3, generator=generator),
        torch.rand(200, 90, generator=generator).argsort(1)[:, :3],
    )
    faces[:3] = torch.tensor([[4, 4, 4], [5, 6, 7], [8, 9, 9]])
    vertices[5:8] = torch.tensor([[0.0, 0, 0], [1, 2, 3], [2, 4, 6]])
    with recorded_launches() as launches:
        found = triangle_frames(vertices, faces)
    assert [launch.name for launch in launches] == ["place_frames"]
    expected = triangle_frames_torch(vertices.double(), faces)
    wide = torch.ones(200, dtype=torch.bool)
    wide[:3] = False  # the normal of a triangle without area is any perpendicular one
    for part, name in ((0, "centers"), (2, "scales")):
        torch.testing.assert_close(found[part].double(), expected[part], atol=1e-6, rtol=1e-5, msg=name)
    torch.testing.assert_close(found.rotations.double()[wide], expected.rotations[wide], atol=3e-5, rtol=1e-5)
    identity = torch.eye(3).expand(200, 3, 3)
    torch.testing.assert_close(found.rotations.transpose(1, 2) @ found.rotations, identity, atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(found.rotations), torch.ones(200), atol=1e-5, rtol=0)


def test_gradients_of_vertices_are_the_twins() -> None:
    vertices, faces = torch.rand(3, 3).requires_grad_(), torch.tensor([[0, 1, 2]])
    with recorded_launches() as launches:
        triangle_frames(vertices, faces).centers.sum().backward()
    assert launches == [] and vertices.grad is not None
    torch.testing.assert_close(vertices.grad, torch.full((3, 3), 1 / 3))


def test_kernels_compile_without_spilling(registers_of: Callable[..., dict[str, int]]) -> None:
    with recorded_launches() as launches:
        triangle_frames(torch.rand(3, 3), torch.tensor([[0, 1, 2]]))
    found: dict[str, Any] = registers_of(launches)
    assert found.keys() == {"place_frames"} and found["place_frames"] <= 64
