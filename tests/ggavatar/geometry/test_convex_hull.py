"""Convex outlines against areas and membership by hand."""

from __future__ import annotations

import math

import torch

from ggavatar.geometry.convex_hull import hull_mask


def test_a_rectangle_by_hand() -> None:
    corners = torch.tensor([[2.0, 1.0], [7.0, 1.0], [7.0, 4.0], [2.0, 4.0], [4.0, 2.0]])  # the last lies inside
    expected = torch.zeros(6, 10, 1)
    expected[1:4, 2:7] = 1
    assert torch.equal(hull_mask(corners, 6, 10), expected)


def test_an_ellipse_has_its_area_and_no_hole() -> None:
    angle = torch.linspace(0, 2 * math.pi, 200)
    mask = hull_mask(torch.stack((50 + 30 * angle.cos(), 40 + 12 * angle.sin()), dim=-1), 80, 100)
    assert mask.sum().item() == math.floor(mask.sum().item()) and abs(mask.sum().item() - math.pi * 30 * 12) < 12
    assert mask[40, 50] == 1 and mask[40, 85] == 0 and mask[55, 50] == 0


def test_points_on_a_line_outline_nothing() -> None:
    line = torch.arange(5.0)[:, None].expand(-1, 2)
    assert not hull_mask(line, 8, 8).any() and not hull_mask(line[:2], 8, 8).any()


def test_outside_the_image_is_cut_off() -> None:
    assert hull_mask(torch.tensor([[-9.0, -9.0], [99.0, -9.0], [-9.0, 99.0]]), 4, 5).all()
    assert not hull_mask(torch.tensor([[-9.0, -9.0], [-5.0, -9.0], [-9.0, -5.0]]), 4, 5).any()
