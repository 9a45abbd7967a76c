"""Initial colors against weights computed pixel by pixel from the reference rasterizer's renderings."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.core import Camera, Drive, Frame, Gaussians
from ggavatar.gaussians.initial_colors import SH_C0, rgb_to_sh, splatted_colors
from ggavatar.head.model import HeadModel
from ggavatar.render.harmonics import sh_to_rgb
from ggavatar.render.reference import rasterize

CAMERA = Camera(torch.tensor([[30.0, 0, 12], [0, 30.0, 12], [0, 0, 1]]), torch.eye(4), 24, 24)


def blobs() -> Gaussians:
    means = torch.tensor([[-0.1, 0.0, 1.0], [0.1, 0.0, 1.2], [0.0, 0.0, 5.0], [0.0, 0.0, -1.0]])
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(4, 1)
    return Gaussians(means, quats, torch.full((4, 3), 0.06), torch.tensor([0.9, 0.7, 0.5, 0.5]), torch.zeros(4, 3))


def weights(index: int) -> torch.Tensor:
    """How much a Gaussian contributes to every pixel: what is rendered if only it is white."""
    colors = torch.zeros(4, 3)
    colors[index] = 1.0
    return rasterize(dataclasses.replace(blobs(), colors=colors), CAMERA, torch.zeros(3)).image[..., :1]


def test_colours_are_weighted_means_of_pixels(toy_head: HeadModel) -> None:
    generator = torch.Generator().manual_seed(0)
    drive: Drive = toy_head.neutral_drive()
    frames = [Frame(drive, CAMERA, *(torch.rand(24, 24, k, generator=generator) for k in (3, 1))) for _ in range(2)]
    found = splatted_colors(lambda _: blobs(), frames, rasterize)
    for index in (0, 1):
        shares = [weights(index) * frame.alpha for frame in frames]
        total = sum(float(share.sum()) for share in shares)
        expected = sum((share * frame.image).sum((0, 1)) for share, frame in zip(shares, frames, strict=True)) / total
        assert torch.allclose(found[index], torch.as_tensor(expected), atol=1e-5)
    seen = torch.tensor([float(weights(index).sum()) > 0.05 for index in range(4)])
    assert seen.tolist()[3] is False
    assert torch.allclose(found[3], found[seen].mean(0), atol=1e-5)


def test_background_lends_no_colour(toy_head: HeadModel) -> None:
    """A Gaussian before a red person and a white wall is red; one before the wall alone is as the others."""
    alpha = torch.zeros(24, 24, 1)
    alpha[:, :9] = 1.0
    image = alpha * torch.tensor([1.0, 0.0, 0.0]) + (1 - alpha)
    found = splatted_colors(lambda _: blobs(), [Frame(toy_head.neutral_drive(), CAMERA, image, alpha)], rasterize)
    assert torch.allclose(found, torch.tensor([1.0, 0.0, 0.0]).expand(4, 3), atol=1e-5)


def test_no_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        splatted_colors(lambda _: blobs(), [], rasterize)


def test_sh_of_a_colour_shows_as_it() -> None:
    colors = torch.rand(5, 3, generator=torch.Generator().manual_seed(1))
    shown = sh_to_rgb(rgb_to_sh(colors)[:, None], torch.ones(5, 3), torch.zeros(3), 0)
    assert torch.allclose(shown, colors, atol=1e-6)
    assert pytest.approx(0.5 / torch.pi**0.5) == SH_C0
