"""Visible weights against sums in closed form, and which Gaussians go."""

from __future__ import annotations

import torch

from ggavatar.core import Camera, Drive, Frame, Gaussians, Rendering
from ggavatar.formats.web.pruning import kept_rows, visible_weights
from ggavatar.render.reference import rasterize


class Three:
    """A Gaussian, one that it hides completely, and one behind the camera."""

    def gaussians(self, drive: Drive) -> Gaussians:
        means = torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, -1]])
        quats, scales = torch.tensor([[1.0, 0, 0, 0]]).repeat(3, 1), torch.tensor([[0.5] * 3, [0.02] * 3, [0.1] * 3])
        return Gaussians(means, quats, scales, torch.full((3,), 0.99), torch.rand(3, 4, 3), 1)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, torch.Tensor]:
        return {}

    def optimizers(self) -> list[torch.optim.Optimizer]:
        return []

    def after_backward(self, rendering: Rendering, step: int) -> None:
        pass


def test_weights_are_sums_of_alpha_times_transmittance() -> None:
    size = 33
    intrinsics = torch.tensor([[30.0, 0, size / 2], [0, 30.0, size / 2], [0, 0, 1]])
    camera = Camera(intrinsics, torch.eye(4), size, size)
    drive = Drive(torch.zeros(0), torch.zeros(0, 3), torch.zeros(2), torch.zeros(3), torch.eye(4))
    avatar = Three()
    found = visible_weights(avatar, rasterize, [(drive, camera), (drive, camera)])
    drawn = rasterize(avatar.gaussians(drive), camera, torch.zeros(3))
    torch.testing.assert_close(found.sum(), drawn.alpha.sum(), rtol=1e-5, atol=1e-4)
    assert found[2] == 0 and found[1] < 0.02 * found[0]


def test_the_least_visible_go_with_their_share() -> None:
    weights, opacities = torch.tensor([5.0, 0.0, 3.0, 2.0, 0.01]), torch.tensor([0.9, 0.9, 0.001, 0.9, 0.9])
    assert kept_rows(weights, opacities, 0.01).tolist() == [True, False, False, True, False]
    assert kept_rows(weights, opacities, 0.25).tolist() == [True, False, False, False, False]
    assert kept_rows(weights, torch.ones(5), 0.0).tolist() == [True, False, True, True, True]
