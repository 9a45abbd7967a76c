"""Binding and refinement by Triton kernels, interpreted, against the torch twins in float64; compiled without spilling.

Also covers `ggavatar/gaussians/offsets_triton.py`, `ggavatar/jit/triton_vectors.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from ggavatar.gaussians import binding, offsets
from ggavatar.gaussians.binding import WorldGeometry, bind, bind_in_torch
from ggavatar.gaussians.offsets import Offsets, refine, refine_in_torch
from ggavatar.geometry.transforms import quaternion_to_matrix
from ggavatar.geometry.triangles import TriangleFrames
from ggavatar.jit import device_kernels
from tests.support.kernel_compiler import recorded_launches
from tests.support.render_scenes import relative_error
from tests.support.triton_kernels import interpreted

pytestmark = interpreted
COUNT = 150


@pytest.fixture(autouse=True)
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU tensors take the way of those on CUDA; float64 stays with the twins."""
    monkeypatch.setattr(binding, "compiled_for", lambda *_: False)
    monkeypatch.setattr(offsets, "compiled_for", lambda *_: False)
    monkeypatch.setattr(device_kernels, "run_on", lambda *tensors: all(t.dtype is not torch.float64 for t in tensors))


def normal(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def triangles(dtype: torch.dtype) -> TriangleFrames:
    """Ten triangles; the rotations of the first four are the identity and half turns, whose real part is 0."""
    quats = torch.cat((torch.eye(4), normal(6, 4, seed=1)))
    rotations = quaternion_to_matrix(quats.double()).to(dtype)
    return TriangleFrames(normal(10, 3, seed=2).to(dtype), rotations, (0.1 + normal(10, seed=3).abs()).to(dtype))


class Found(NamedTuple):
    """The world geometry, and the gradients of a random linear function of it."""

    world: WorldGeometry
    gradients: tuple[Tensor, ...]


def with_gradients(world: WorldGeometry, leaves: list[Tensor]) -> Found:
    loss = sum((part * normal(*part.shape, seed=9).to(part.dtype)).sum() for part in world)
    assert isinstance(loss, Tensor)
    return Found(world, torch.autograd.grad(loss, leaves))


def bound(dtype: torch.dtype) -> Found:
    index = torch.randint(10, (COUNT,), generator=torch.Generator().manual_seed(4))
    local = [value.to(dtype).requires_grad_() for value in (normal(COUNT, 3), normal(COUNT, 4), 0.3 * normal(COUNT, 3))]
    call = bind_in_torch if dtype is torch.float64 else bind
    return with_gradients(call(*local, index, triangles(dtype)), local)


def refined(dtype: torch.dtype, width: int) -> Found:
    quats = torch.nn.functional.normalize(normal(COUNT, 4), dim=-1)
    given = [normal(COUNT, 3), quats, normal(COUNT, 3).exp(), 0.5 * normal(COUNT, width)]
    leaves = [value.to(dtype, copy=True).requires_grad_() for value in given]
    call = refine_in_torch if dtype is torch.float64 else refine
    return with_gradients(call(*leaves[:3], Offsets(leaves[3]), 0.02), leaves)


@pytest.mark.parametrize("width", [0, 10, 13], ids=["binding", "geometry", "geometry-and-color"])
def test_geometry_and_gradients_equal_the_twin_in_float64(width: int) -> None:
    with recorded_launches() as launches:
        found = refined(torch.float32, width) if width else bound(torch.float32)
    expected = refined(torch.float64, width) if width else bound(torch.float64)
    kernels = ["refine_gaussians", "differentiate_refinement"] if width else ["bind_gaussians", "differentiate_binding"]
    assert [launch.name for launch in launches] == kernels
    for fast, slow in zip(found.world, expected.world, strict=True):
        torch.testing.assert_close(fast.double(), slow, atol=2e-6, rtol=1e-5)
    assert max(relative_error(*pair) for pair in zip(found.gradients, expected.gradients, strict=True)) < 1e-5


def test_triangles_that_want_a_gradient_are_left_to_the_twin() -> None:
    frames = triangles(torch.float32)
    wanted = TriangleFrames(frames.centers.requires_grad_(), *frames[1:])
    with recorded_launches() as launches:
        world = bind(normal(4, 3), normal(4, 4), normal(4, 3), torch.tensor([0, 1, 1, 9]), wanted)
    world.means.sum().backward()
    assert launches == [] and frames.centers.grad is not None
    assert frames.centers.grad[:, 0].tolist() == [1.0, 2.0, 0, 0, 0, 0, 0, 0, 0, 1.0]


def test_kernels_compile_without_spilling(registers_of: Callable[..., dict[str, int]]) -> None:
    with recorded_launches() as launches:
        bound(torch.float32)
        refined(torch.float32, 13)
    assert max(registers_of(launches).values()) <= 64
