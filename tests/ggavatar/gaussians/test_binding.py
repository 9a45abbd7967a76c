"""Eq. 6–8 against a plain loop, the twin, float64 autograd and what rigid motions and similarities must do.

Also covers `ggavatar/gaussians/binding_kernel.py`, `ggavatar/jit/quaternions.py`, `ggavatar/jit/vectors.py`.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from ggavatar.gaussians.binding import bind, bind_in_torch
from ggavatar.geometry.transforms import axis_angle_to_matrix, quaternion_to_matrix
from ggavatar.geometry.triangles import TriangleFrames, triangle_frames

FACES, COUNT = 30, 400


def scene(dtype: torch.dtype, frames_learn: bool = False) -> tuple[list[Tensor], Tensor, TriangleFrames]:
    generator = torch.Generator().manual_seed(5)

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)

    local = [draw(COUNT, 3), draw(COUNT, 4), 0.3 * draw(COUNT, 3)]
    frames = TriangleFrames(draw(FACES, 3), quaternion_to_matrix(draw(FACES, 4)), draw(FACES).abs() + 0.1)
    index = torch.randint(0, FACES, (COUNT,), generator=generator)
    if frames_learn:
        frames = TriangleFrames(*(value.requires_grad_() for value in frames))
    return [value.requires_grad_() for value in local], index, frames


def weighed(placed: tuple[Tensor, ...]) -> Tensor:
    """A scalar that depends on every number."""
    generator = torch.Generator().manual_seed(6)
    return torch.stack(
        [(value * torch.randn(value.shape, generator=generator, dtype=torch.float64)).sum() for value in placed]
    ).sum()


def relative(ours: Tensor, reference: Tensor) -> float:
    return float((ours.double() - reference).norm() / reference.norm())


@pytest.mark.parametrize("frames_learn", [False, True])
def test_compiled_equals_float64_autograd(frames_learn: bool) -> None:
    local, index, frames = scene(torch.float32, frames_learn)
    wide, _, wide_frames = scene(torch.float64, frames_learn)
    placed, expected = bind(*local, index, frames), bind_in_torch(*wide, index, wide_frames)
    weighed(placed).backward()
    weighed(expected).backward()
    for ours, reference in zip(placed, expected, strict=True):
        assert relative(ours.detach(), reference.detach()) < 1e-6
    inputs = zip([*local, *(frames if frames_learn else [])], [*wide, *wide_frames], strict=False)
    for ours, reference in inputs:
        assert ours.grad is not None and reference.grad is not None
        assert relative(ours.grad, reference.grad) < 2e-6


def test_eq6_to_eq8_one_by_one() -> None:
    local, index, frames = scene(torch.float64)
    placed = bind(*local, index, frames)
    for n in range(0, COUNT, 37):
        size, turn, center = frames.scales[index[n]], frames.rotations[index[n]], frames.centers[index[n]]
        assert torch.allclose(placed.means[n], size * turn @ local[0][n] + center)
        assert torch.allclose(quaternion_to_matrix(placed.quats[n]), turn @ quaternion_to_matrix(local[1][n]))
        assert torch.allclose(placed.scales[n], size * local[2][n].exp())


def test_quaternions_are_unit_and_zero_means_sit_at_centroids() -> None:
    local, index, frames = scene(torch.float32)
    placed = bind(torch.zeros(COUNT, 3), local[1], local[2], index, frames)
    assert torch.allclose(placed.quats.norm(dim=-1), torch.ones(COUNT), atol=1e-6)
    assert torch.equal(placed.means, frames.centers[index])


@pytest.mark.parametrize("factor", [1e-3, 1.0, 10.0])
def test_similarity_of_the_mesh_carries_the_gaussians_along(factor: float) -> None:
    generator = torch.Generator().manual_seed(7)
    corners = torch.randn(3 * FACES, 3, generator=generator)
    faces = torch.arange(3 * FACES).view(FACES, 3)
    turn, shift = axis_angle_to_matrix(torch.tensor([0.3, -1.2, 0.5])), torch.tensor([0.4, 1.0, -2.0])
    local, index, _ = scene(torch.float32)
    before = bind(*local, index, triangle_frames(corners, faces))
    after = bind(*local, index, triangle_frames(factor * corners @ turn.T + shift, faces))
    assert torch.allclose(after.means, factor * before.means @ turn.T + shift, atol=2e-4)
    assert torch.allclose(after.scales, factor * before.scales, rtol=1e-3)
    turned = turn @ quaternion_to_matrix(before.quats)
    assert torch.allclose(quaternion_to_matrix(after.quats), turned, atol=2e-3)


@pytest.mark.parametrize("threads", [2, 4])
def test_same_bits_for_any_number_of_threads(threads: int) -> None:
    before, found = torch.get_num_threads(), []
    index = torch.arange(20_000) % FACES
    _, _, frames = scene(torch.float32)
    try:
        for count in (1, threads):
            torch.set_num_threads(count)
            generator = torch.Generator().manual_seed(8)
            local = [torch.randn(20_000, k, generator=generator).requires_grad_() for k in (3, 4, 3)]
            weighed(bind(*local, index, frames)).backward()
            found.append([value.grad for value in local])
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


def test_no_gaussians() -> None:
    _, _, frames = scene(torch.float32)
    placed = bind(torch.zeros(0, 3), torch.zeros(0, 4), torch.zeros(0, 3), torch.zeros(0, dtype=torch.int64), frames)
    assert placed.means.shape == (0, 3)


def test_scales_far_out_stay_what_they_are() -> None:
    """The compiled exponential at the ends of float32 and beyond; a NaN must reach whoever looks for it."""
    _, _, frames = scene(torch.float32)
    logs = torch.tensor([[-80.0, -20.0, -1e-6], [0.0, 20.0, 80.0], [float("nan"), 1e4, -1e4]])
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(3, 4)
    unit = TriangleFrames(frames.centers[:1], torch.eye(3)[None], torch.ones(1))
    placed = bind(torch.zeros(3, 3), quats, logs, torch.zeros(3, dtype=torch.int64), unit)
    expected = logs.double().exp()
    assert torch.allclose(placed.scales[:2].double(), expected[:2], rtol=3e-7)
    assert placed.scales[2, 0].isnan() and placed.scales[2, 1] > 1e38 and placed.scales[2, 2] < 1e-37
