"""Samples on a mesh against closed forms: texel grids by hand, even shares, area's centroid, a procedural head."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.core import Camera
from ggavatar.geometry.transforms import look_at
from ggavatar.geometry.uv_sampling import (
    camera_facing,
    face_areas,
    lower_boundary,
    morton_order,
    strip_samples,
    texel_samples,
)
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head

SQUARE = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = torch.tensor([[0, 1, 2], [0, 2, 3]])


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return procedural_head()


def test_every_texel_of_a_full_layout_has_its_own_place() -> None:
    samples = texel_samples(SQUARE[HALVES][..., :2], 8)
    rows, columns = torch.meshgrid(torch.arange(8), torch.arange(8), indexing="ij")
    centers = torch.stack((columns, rows, torch.zeros_like(rows)), dim=-1).reshape(-1, 3)
    expected = (centers + torch.tensor([0.5, 0.5, 0.0])) / 8
    assert torch.allclose(samples.points(SQUARE, HALVES), expected, atol=1e-6)
    assert torch.equal(samples.face, (centers[:, 1] > centers[:, 0]).long())  # a texel on the diagonal: the first


def test_texels_outside_all_triangles_have_no_sample_and_overlaps_belong_to_the_first() -> None:
    small = torch.tensor([[[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]])
    assert len(texel_samples(small, 8).face) == 10  # 4 + 3 + 2 + 1 centers
    twice = texel_samples(torch.cat((small.flip(1), small)), 8)
    assert len(twice.face) == 10 and not twice.face.any()
    nothing = texel_samples(torch.zeros(2, 3, 2), 8)
    assert len(nothing.face) == 0


def test_texels_beyond_the_texture_are_left_out() -> None:
    big = torch.tensor([[[-1.0, -1.0], [3.0, -1.0], [-1.0, 3.0]]])
    assert len(texel_samples(big, 4).face) == 16


@pytest.mark.parametrize("count", [1, 40, 5_000])
def test_triangles_of_a_strip_get_their_share_of_samples(head: HeadModel, count: int) -> None:
    room = face_areas(head.template, head.faces)
    room[::3] = 0
    samples = strip_samples(head.template, head.faces, room, count)
    assert len(samples.face) == count and samples.weights.min() >= 0
    assert torch.allclose(samples.weights.sum(-1), torch.ones(count), atol=1e-6)
    share = room.double() / room.double().sum() * count
    got = torch.bincount(samples.face, minlength=len(room))
    assert (got >= (share - 1e-6).floor()).all() and (got <= (share + 1e-6).ceil()).all()


def test_samples_within_a_triangle_are_even_in_area() -> None:
    """First and second moments of the uniform distribution on the unit square, from 2,000 samples."""
    samples = strip_samples(SQUARE, HALVES, face_areas(SQUARE, HALVES), 2_000)
    x, y, _ = samples.points(SQUARE, HALVES).double().unbind(-1)
    moments = torch.stack((x.mean(), y.mean(), x.square().mean(), y.square().mean(), (x * y).mean()))
    assert torch.allclose(moments, torch.tensor([1 / 2, 1 / 2, 1 / 3, 1 / 3, 1 / 4]).double(), atol=2e-3)
    cells = torch.bincount((x * 10).long() * 10 + (y * 10).long(), minlength=100)
    assert cells.min() >= 14 and cells.max() <= 26  # 20 each; independent draws would have a deviation of 4.5


def test_samples_ride_on_the_mesh(head: HeadModel) -> None:
    samples = strip_samples(head.template, head.faces, face_areas(head.template, head.faces), 300)
    expected = sum(samples.weights[:, k, None] * head.template[head.faces[samples.face, k]] for k in range(3))
    assert torch.allclose(samples.points(head.template, head.faces), expected, atol=1e-7)
    shift = torch.tensor([0.1, -0.2, 0.3])
    moved = samples.points(head.template + shift, head.faces)
    assert torch.allclose(moved, samples.points(head.template, head.faces) + shift, atol=1e-6)


def test_curve_visits_the_octants_one_after_the_other() -> None:
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0))
    points = torch.cat((points, torch.zeros(1, 3), torch.ones(1, 3)))
    octant = ((points * 1023).long() >= 512).long() @ torch.tensor([1, 2, 4])
    visited = octant[morton_order(points)]
    assert (visited.diff() >= 0).all() and visited[0] == 0 and visited[-1] == 7


def test_areas(head: HeadModel) -> None:
    assert torch.allclose(face_areas(SQUARE, HALVES), torch.tensor([0.5, 0.5]))
    assert torch.allclose(face_areas(2 * head.template, head.faces), 4 * face_areas(head.template, head.faces))


def test_facing_is_seen_from_one_side_and_within_the_image_only() -> None:
    pose = look_at(torch.tensor([0.5, 0.5, 3.0]), torch.tensor([0.5, 0.5, 0.0]), torch.tensor([0.0, 1.0, 0.0]))
    intrinsics = torch.tensor([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])
    camera = Camera(intrinsics, pose, 100, 100)
    assert camera_facing([SQUARE], [camera], HALVES).tolist() == [True, True]
    assert camera_facing([SQUARE], [camera], HALVES.flip(1)).tolist() == [False, False]
    aside = dataclasses.replace(camera, width=50)  # shows x < 0.5 only
    assert camera_facing([SQUARE], [aside], HALVES).tolist() == [True, True]
    right = torch.stack((SQUARE, SQUARE + torch.tensor([1.0, 0, 0]))).flatten(0, 1)
    both = torch.cat((HALVES, HALVES + 4))
    assert camera_facing([right], [aside], both).tolist() == [True, True, False, False]
    assert camera_facing([right - torch.tensor([1.0, 0, 0]), right], [aside, aside], both).all()
    assert not camera_facing([], [], HALVES).any()


def test_rim_is_the_lower_end_of_an_open_mesh(head: HeadModel, toy_head: HeadModel) -> None:
    rim = lower_boundary(head.template, head.faces)
    heights = head.template[head.faces[rim]][..., 1]
    assert 20 < rim.sum() < 400
    assert heights.max() < head.template[:, 1].min() + 0.05
    assert not lower_boundary(toy_head.template, toy_head.faces).any()  # a closed egg
